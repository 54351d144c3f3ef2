"""What can go wrong: a class for each kind of error of the library, all of them `Error`.

A message names the file, tensor or option with what was expected and what came; the attributes have the parts.
"""

import builtins


class Error(Exception):
    """Everything that this package raises of its own."""

    def __init__(self, message: str, **fields: object) -> None:
        super().__init__(message)
        self.__dict__.update(fields)


class TensorError(Error):
    """A tensor has another shape or element type than an operation takes."""

    op: str
    tensor: str
    expected: str
    got: str


class ParamError(Error, ValueError):
    """An argument is out of its range, or a picture is no array that can be one."""

    op: str
    param: str
    expected: str
    got: str


class CapacityError(Error):
    """A fixed capacity is too small; nothing was dropped silently."""

    what: str
    needed: int
    available: int


class ShaderError(Error):
    """A shader does not compile."""

    file: str
    line: int


class NoAdapterError(Error):
    """No GPU adapter matches `device`."""

    wanted: str
    found: str


class DeviceError(Error):
    """The adapter refused to open a device."""

    adapter: str


class DeviceLostError(Error):
    """The GPU was lost, and could not be opened anew."""


class TimeoutError(Error, builtins.TimeoutError):
    """The device did not finish within `timeout`."""

    stage: str
    seconds: float


class DriverError(Error):
    """The GPU's driver reported an error."""

    stage: str


class WeightsError(Error):
    """A weight file is missing, damaged or no network."""

    file: object


class NoWeightsError(Error):
    """No weights have the name that was asked for."""

    name: str
    searched: list[object]


class SensorError(Error):
    """A sensor file is damaged, or a frame cannot be the sensor's."""

    sensor: str


class ScaleError(Error):
    """A frame cannot have the scale or the gel that is said of it, or nobody says its scale."""

    width: int
    height: int


class FileError(Error):
    """A file of another kind cannot be used."""

    file: object


class PictureError(Error):
    """A picture cannot be used: it is empty, missing, damaged, or of no known format."""

    file: str


class NotFiniteError(Error):
    """The network produced values that are not finite."""

    stage: str
    count: int


class OverflowError(Error, builtins.OverflowError):
    """A device produced such values where the f64 reference did not."""

    stage: str
    count: int
    precision: str


class ForkError(Error):
    """A detector was used in a process that was forked from its own, where its threads are missing."""


def param(param: str, expected: str, got: object) -> ParamError:
    """An argument that cannot be taken."""
    message = f"detect: parameter `{param}`: expected {expected}, got {got}"
    return ParamError(message, op="detect", param=param, expected=expected, got=str(got))
