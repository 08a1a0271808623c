"""Plug-ins and users' modules: found, made, checked; and the protocols that they fulfil."""
