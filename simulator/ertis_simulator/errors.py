"""What the simulator reports to its user."""

from ertis_driver.errors import ErtisError


class SceneError(ErtisError):
    """A scene file cannot be read or asks for something impossible: correct it."""
