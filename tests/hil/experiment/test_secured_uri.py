"""A link's URI with the options that the tables of an experiment stand for."""

from __future__ import annotations

import pytest

from hil.experiment.rig_tables import Auth, Login, Tls, secured_uri

KEY, FOLDER, USERS = Auth(key_file="{role}.key"), Tls(keys="certs"), Login(users="u.txt")
FILES = Tls(ca="a b.pem", cert="/abs/c.pem", key="k.pem")
ZENOH = "zenoh:tls/h:7447"


@pytest.mark.parametrize(
    ("uri", "auth", "tls", "login", "expected"),
    [
        (ZENOH, None, None, None, ZENOH),
        (ZENOH, KEY, None, None, f"{ZENOH}?auth=/lab/{{role}}.key"),
        (ZENOH, None, FOLDER, None, f"{ZENOH}?keys=/lab/certs"),
        (ZENOH, None, FILES, None, f"{ZENOH}?ca=/lab/a%20b.pem&cert=/abs/c.pem&key=/lab/k.pem"),
        (ZENOH, None, None, USERS, f"{ZENOH}?users=/lab/u.txt"),
        (ZENOH, KEY, FOLDER, USERS, f"{ZENOH}?auth=/lab/{{role}}.key&keys=/lab/certs&users=/lab/u.txt"),
        (f"{ZENOH}?keys=/own", None, FILES, USERS, f"{ZENOH}?keys=/own&users=/lab/u.txt"),
        (f"{ZENOH}?ca=/own.pem", None, FOLDER, None, f"{ZENOH}?ca=/own.pem"),
        ("can:hil:rig0", KEY, FOLDER, USERS, "can:hil:rig0?auth=/lab/{role}.key"),
    ],
)
def test_a_uri_takes_of_the_tables_what_its_link_knows_and_keeps_its_own(
    uri: str, auth: Auth | None, tls: Tls | None, login: Login | None, expected: str
) -> None:
    assert secured_uri(uri, "/lab", auth, tls, login) == expected
