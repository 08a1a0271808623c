"""The one error root of the package."""


class PlantError(Exception):
    """A plant was asked for something that its equations cannot give (the message names the object and the value)."""
