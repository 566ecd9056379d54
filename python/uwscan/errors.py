"""What uwscan raises and warns of: a class by kind, each also the built-in kind that it is.

Messages are those of the command `uwscan`: they name the file, the place in it, what is wrong and how to mend it.
"""

from __future__ import annotations

__all__ = [
    "AlignmentError",
    "CalibrationError",
    "CaptureError",
    "DtypeError",
    "ExistingFileError",
    "FileError",
    "FitError",
    "FormatError",
    "GeometryError",
    "InputError",
    "InstrumentError",
    "LossWarning",
    "MissingFileError",
    "SimulationError",
    "SurfaceError",
    "UwscanError",
    "UwscanWarning",
]


class UwscanError(Exception):
    """Anything that uwscan raises.

    Attributes
    ----------
    noticed : list of str
        What had been noticed before, which may be the cause: warnings, lost files, rejected images.
    """

    noticed: list[str] = []


class InputError(UwscanError, ValueError):
    """An argument that can't be used: a shape, a value, an option."""


class DtypeError(InputError, TypeError):
    """An array of a type that can't be used."""


class FileError(UwscanError, OSError):
    """The operating system refused a file; `filename` and `errno` say which and why."""

    def __str__(self) -> str:
        # OSError would say it in its own words once it knows errno.
        return str(self.args[0]) if self.args else ""


class MissingFileError(FileError, FileNotFoundError):
    """There is no such file or folder."""


class ExistingFileError(FileError, FileExistsError):
    """The output exists and was not to be replaced (`overwrite=True`)."""


class FormatError(UwscanError, ValueError):
    """What a file says is wrong, of another format or of a later version, or an image can't be decoded."""


class CaptureError(UwscanError, ValueError):
    """A capture is of the wrong kind, or its images do not show what is needed."""


class CalibrationError(UwscanError, ValueError):
    """The captures determine no calibration, or a calibration does not suit what is asked of it."""


class FitError(UwscanError, ValueError):
    """The points hold no such shape, or do not determine one."""


class AlignmentError(UwscanError, ValueError):
    """A cloud does not come to lie on a reference or on the other clouds, or does so in several ways."""


class GeometryError(UwscanError, ValueError):
    """Figures of an instrument that there can't be."""


class SurfaceError(UwscanError, ValueError):
    """The points are no surface."""


class SimulationError(UwscanError, ValueError):
    """An instrument or scene that can't be simulated."""


class InstrumentError(UwscanError):
    """A device does not do what is needed."""


class UwscanWarning(UserWarning):
    """What to know before trusting a result."""


class LossWarning(UwscanWarning):
    """An input was missing or unreadable, and the rest was used."""
