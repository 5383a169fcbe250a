"""The error tree: a name says what to do next, a message what was met and expected."""


class ErtisError(Exception):
    """Anything this project reports to its user in one line."""


class AddressError(ErtisError):
    """A device address is malformed or of an unknown kind: correct it."""


class SettingsError(ErtisError, ValueError):
    """A setting lies outside what the device accepts: choose another value."""


class DeviceError(ErtisError):
    """The sonar or the way to it failed."""


class DeviceNotFound(DeviceError):
    """No such device: look at cable, port name and udev rule."""


class DevicePermission(DeviceError):
    """The port exists but may not be opened: install the udev rule or join its group."""


class DeviceBusy(DeviceError):
    """Another process holds the port: end it."""


class DeviceTimeout(DeviceError):
    """No answer, or not all of it, in time: ping again; if it stays silent it is no eRTIS."""


class WrongDevice(DeviceError):
    """Something answers on the port, but not as an eRTIS does: name another port."""


class DeviceBabbles(DeviceError):
    """It sends without end, unasked: stop its trigger or replug it; or it is no eRTIS."""


class DeviceLost(DeviceError):
    """The device went away while open: reopen it."""


class PingLost(DeviceError):
    """The device went away during this ping, and is reopened once it is back: ping again."""


class FrameCorrupt(DeviceError):
    """The frame of this ping is damaged and was dropped: ping again."""


class UploadFailed(DeviceError):
    """The device holds another chirp than was sent: configure it again."""


class OutOfStep(DeviceError):
    """Its answers do not fit what it was asked, bytes were lost or doubled: configure it again."""


class DeviceUnsupported(DeviceError):
    """The firmware declined a request (external trigger, amplifier): do without it."""


class NotConfigured(DeviceError):
    """The device holds no (or no complete) settings: call ``configure`` first."""


class RecordingError(ErtisError):
    """A recording cannot be read: foreign, truncated or damaged."""


class DatasetError(ErtisError):
    """A labelled data set's table or files are not as they should be: correct what it names."""


class RecordingDamaged(RecordingError):
    """A recording is cut off or damaged here, and whole before: recover it.

    offset : int
        Of the damage, bytes from the beginning of the file.
    num_pings : int
        Whole ones before it.
    is_cut : bool
        The rest is missing; else it is there, and wrong.
    """

    def __init__(self, message: str, *, offset: int, num_pings: int, is_cut: bool) -> None:
        super().__init__(message)
        self.offset, self.num_pings, self.is_cut = offset, num_pings, is_cut


class DiskFull(RecordingError):
    """A file takes no more: free some space. A recording under way is whole up to there."""


class EndOfRecording(ErtisError):
    """A replay has played its last ping."""
