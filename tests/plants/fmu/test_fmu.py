"""A functional mock-up unit as a plant: units of FMI 2 and 3, made by the C compiler of this machine."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.experiment import shipped
from plants import FMU
from plants.errors import PlantError

pytest.importorskip("fmpy", reason="FMPy is not installed: pip install 'hilrig[fmu]'")
pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None or sys.platform != "linux", reason="a unit is made by the C compiler: apt-get install gcc"
)
SOURCE = """
#include <stdlib.h>
typedef struct { double u, x, v, m, d, t; int state; } Cart;  /* one that is asked out of the standard's order fails */
static int go(Cart *c, int from, int to) { if (c->state != from) return 3; c->state = to; return 0; }
static void *make(void) { Cart *c = calloc(1, sizeof *c); c->m = 1.0; c->d = 2.0; return c; }
static double *at(Cart *c, unsigned r) { double *all[] = {&c->u, &c->x, &c->v, &c->m, &c->d}; return all[r]; }
static int put(Cart *c, const unsigned *r, size_t n, const double *v) {
  for (size_t i = 0; i < n; i++) { if (r[i] > 2 && c->state == 3) return 3; *at(c, r[i]) = v[i]; }
  return 0; }
static int get(void *c, const unsigned *r, size_t n, double *v) {
  for (size_t i = 0; i < n; i++) v[i] = *at(c, r[i]);
  return 0; }
static int step(Cart *c, double t, double h) {  /* x' = v, m v' = u - d v, by Euler's steps of 1 ms */
  if (c->state != 3 || t - c->t > 1e-12 || c->t - t > 1e-12) return 3;
  c->t = t + h;
  long n = (long)(h * 1e3 + 0.5);
  for (long i = 0; i < n; i++) { double a = (c->u - c->d * c->v) / c->m; c->x += 1e-3 * c->v; c->v += 1e-3 * a; }
  return 0; }
void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void *f, int v, int l) { return make(); }
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int d, double tol, double t0, int s, double t1) { return t0 ? 3 : go(c, 0, 1); }
int fmi2EnterInitializationMode(void *c) { return go(c, 1, 2); }
int fmi2ExitInitializationMode(void *c) { return go(c, 2, 3); }
int fmi2Terminate(void *c) { return 0; }
int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *v) { return put(c, r, n, v); }
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *v) { return get(c, r, n, v); }
int fmi2DoStep(void *c, double t, double h, int no) { return step(c, t, h); }
void *fmi3InstantiateCoSimulation(const char *n, const char *t, const char *r, _Bool v, _Bool l, _Bool e, _Bool early,
  const unsigned *req, size_t nr, void *env, void *log, void *up) { return make(); }
void fmi3FreeInstance(void *c) { free(c); }
int fmi3EnterInitializationMode(void *c, _Bool td, double tol, double t0, _Bool sd, double t1) { return go(c, 0, 2); }
int fmi3ExitInitializationMode(void *c) { return go(c, 2, 3); }
int fmi3Terminate(void *c) { return 0; }
int fmi3SetFloat64(void *c, const unsigned *r, size_t n, const double *v, size_t nv) { return put(c, r, n, v); }
int fmi3GetFloat64(void *c, const unsigned *r, size_t n, double *v, size_t nv) { return get(c, r, n, v); }
int fmi3DoStep(void *c, double t, double h, _Bool no, _Bool *ev, _Bool *term, _Bool *early, double *last) {
  *ev = *term = *early = 0; *last = t + h; return step(c, t, h); }
"""
REAL = '<ScalarVariable name="{0}" valueReference="{1}" causality="{2}" {3}><Real {4}/></ScalarVariable>'
FLOAT = '<Float64 name="{0}" valueReference="{1}" causality="{2}" {3} {4}/>'
CART = (
    ("Force", 0, "input", "", 'start="0"'), ("x", 1, "output", "", ""), ("v", 2, "local", "", ""),
    ("m", 3, "parameter", 'variability="fixed"', 'start="1"'), ("d", 4, "parameter", 'variability="fixed"', 'start="2"'),
)  # fmt: skip
VERSION_2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="cart" guid="{{1}}"><CoSimulation modelIdentifier="cart"/>
<ModelVariables>{variables}</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure></fmiModelDescription>"""
VERSION_3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="cart" instantiationToken="{{1}}"><CoSimulation modelIdentifier="cart"/>
<ModelVariables><Float64 name="time" valueReference="9" causality="independent"/>{variables}</ModelVariables>
<ModelStructure><Output valueReference="1"/></ModelStructure></fmiModelDescription>"""
LINEAR: dict[str, Any] = {"A": [[0.0, 1.0], [0.0, -2.0]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]]}
RUN: dict[str, Any] = {"duration": 2, "limits.state": {}, "controller": -0.4, "allow_uncertified": True}


@pytest.fixture(scope="session")
def units(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one cart as cart2.fmu and cart3.fmu, and an experiment."""
    folder = tmp_path_factory.mktemp("fmu")
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    asked = {name for cls in (FMU2Slave, FMU3Slave) for name in dir(cls) if re.match("fmi[23][A-Z]", name)}
    rest = "".join(f"int {name}(void) {{ return 3; }}\n" for name in sorted(asked) if f"{name}(" not in SOURCE)
    (folder / "cart.c").write_text(SOURCE + rest)
    (folder / "torn.c").write_text(SOURCE)
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-w", "-o", folder / "torn.so", folder / "torn.c"], check=True)
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-w", "-o", folder / "cart.so", folder / "cart.c"], check=True)
    for version, text, form, platform in ((2, VERSION_2, REAL, "linux64"), (3, VERSION_3, FLOAT, "x86_64-linux")):
        with zipfile.ZipFile(folder / f"cart{version}.fmu", "w") as file:
            file.writestr("modelDescription.xml", text.format(variables="".join(form.format(*v) for v in CART)))
            file.write(folder / "cart.so", f"binaries/{platform}/cart.so")
    with zipfile.ZipFile(folder / "torn.fmu", "w") as file:
        file.writestr("modelDescription.xml", VERSION_2.format(variables="".join(REAL.format(*v) for v in CART)))
        file.write(folder / "torn.so", "binaries/linux64/cart.so")
    (folder / "exp.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    return folder


@pytest.mark.parametrize("version", [2, 3])
def test_a_unit_runs_like_the_plant_that_it_computes(units: Path, version: int) -> None:
    plant = {"kind": "fmu", "file": f"cart{version}.fmu", **LINEAR, "logged": ["x", "v"], "parameters": {"d": 2.0}}
    log = units / f"{version}.mcap"
    session = hil.run(units / "exp.toml", plant=plant, log=log, **RUN)
    exact = hil.run("dc-motor-hinf", plant={"kind": "state-space", **LINEAR}, **RUN)
    x, y = session.arrays["/plant/state"]["x"], exact.arrays["/plant/state"]["x1"]
    assert np.abs(x - y).max() < 2e-3 * np.abs(y).max() and np.abs(y).max() > 0.2  # Euler's steps of 1 ms
    assert "force" in (session.arrays["/actuator/applied"].dtype.names or ())
    assert "FMU" in session.summary["certificate"]["reason"] and session.summary["certificate"]["state"] == "undecided"
    with pytest.raises(hil.HilError, match=r"its plant was fmu, .*--folder DIR"):
        hil.verify(log)  # native code is not run because a log names it
    assert hil.verify(log, folder=units).difference is None


def test_parameters_reach_the_unit(units: Path) -> None:
    carts = [FMU(file="cart2.fmu", **LINEAR, parameters={"m": m}).with_files(str(units)) for m in (1.0, 4.0)]
    assert all(cart == replace(cart) and "Unit(" not in repr(cart) for cart in carts)  # its unit says nothing that it does not
    light, heavy = (cart.start(np.random.default_rng(0)) for cart in carts)
    for run in (light, heavy):
        run.advance(100_000_000, (1.0,))
    assert light.measure()[0] > 3.0 * heavy.measure()[0] > 0.0


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"file": "gone.fmu"}, r"plant\.file: .*gone\.fmu: is no file"),
        ({"file": "cart.c"}, r"plant\.file: .*cart\.c: is no FMU"),
        ({"file": "torn.fmu"}, r"plant\.file: .*torn\.fmu: cannot be started: the unit failed while it started: .*undefined"),
        ({"measured": ["y"]}, r"plant\.measured: .*cart2\.fmu has no real variable 'y'; it has Force, x, v, m, d"),
        ({"measured": ["x", "v"]}, r"plant\.measured: 2 variables \(x, v\), but the model has 1"),
        ({"parameters": {"mass": 1.0}}, r"plant\.parameters: .*no real variable 'mass'"),
        ({"sha256": "0" * 64}, r"plant\.sha256: .*it is another file"),
        ({"A": []}, r"plant\.A: expected rows of one length"),
    ],
)
def test_what_a_unit_has_not_is_reported_with_its_key(units: Path, change: dict[str, Any], reported: str) -> None:
    with pytest.raises(hil.HilError, match=reported):
        hil.load_experiment(units / "exp.toml", plant={"kind": "fmu", "file": "cart2.fmu", **LINEAR, **change})


def test_without_fmpy_the_extra_is_named(units: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plants.fmu.find_spec", lambda name: None)
    with pytest.raises(PlantError, match=r"pip install 'hilrig\[fmu\]'"):
        FMU(file="cart2.fmu", **LINEAR).with_files(str(units))


@pytest.mark.realtime
def test_a_unit_runs_in_real_time(units: Path) -> None:
    plant = {"kind": "fmu", "file": "cart3.fmu", **LINEAR}
    session = hil.run(units / "exp.toml", plant=plant, clock="real", link="local:", **RUN)
    assert session.status == 0 and session.summary["slots"] == 40
