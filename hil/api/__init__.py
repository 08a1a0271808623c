"""What a program sees: the functions behind ``import hil``."""
