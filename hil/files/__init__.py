"""Users' files, read and written: regular and of bounded size, whole or not at all; keys, signatures, arrays, TOML."""
