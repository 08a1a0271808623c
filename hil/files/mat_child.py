"""The process that reads one matrix of a MATLAB file with scipy: file on stdin, the array as .npy on stdout.

scipy ends its process on some damaged files (SIGSEGV, SIGBUS) and unpacks what a file asks for. Here it can end this process
only, and take `MOST_MEMORY` and `MOST_CPU_S`. A file is refused by name, class and dimensions before its numbers are read.
"""

import io
import math
import resource
import sys
import warnings

MOST_MEMORY = 1 << 30  # bytes of address space, of which Python with scipy takes a third
MOST_CPU_S = 20
NUMBERS = ("double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))


def main(key: str, most_numbers: int) -> str | None:
    """Write the array of a key to stdout; return the reason if the file holds none that may be read."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_CPU_S, MOST_CPU_S))
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    found = npy_or_reason(sys.stdin.buffer.read(), key, most_numbers)
    if isinstance(found, str):
        return found
    sys.stdout.buffer.write(found)
    return None


def npy_or_reason(data: bytes, key: str, most_numbers: int) -> bytes | str:
    """Return the array of a key in numpy's format, or the reason why the file holds none that may be read."""
    import numpy as np
    from scipy.io import loadmat, whosmat

    warnings.simplefilter("ignore")
    warnings.simplefilter("error", UserWarning)  # of a variable or byte order that scipy cannot read, and returns all the same
    if data.startswith(b"MATLAB 7.3"):
        return "is a MATLAB 7.3 file; save it with -v7"
    file, out = io.BytesIO(data), io.BytesIO()
    try:
        said = {str(name): (tuple(map(int, shape)), str(group)) for name, shape, group in whosmat(file)}  # type: ignore[arg-type]
        if key not in said:
            return f"has no key {key!r}; it has {', '.join(repr(name)[:40] for name in list(said)[:20]) or 'none'}"
        shape, group = said[key]
        if group not in NUMBERS:
            return f"key {key!r}: holds {group}, expected a full matrix of real numbers"
        if min(shape, default=0) < 0 or math.prod(max(length, 1) for length in shape) > most_numbers:
            return f"key {key!r}: an array of shape {shape}; at most {most_numbers} numbers"
        file.seek(0)
        np.save(out, loadmat(file, variable_names=[key])[key], allow_pickle=False)  # type: ignore[arg-type]
    except Exception as error:  # scipy raises what it likes on a damaged file
        return f"is no whole .mat file: {type(error).__name__}: {error}"
    return out.getvalue()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2])))
