"""The loaded Aravis library (GenICam cameras over USB3 Vision and GigE Vision), through ctypes.

A fact of libaravis 0.8: a call with an error to report fills a GError.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from data_schemas.errors import MissingExtraError
from rigs.cameras.genicam import ConnectionBrokenError, FeatureError

LIBRARY: Final = "libaravis-0.8.so.0"
# ArvDeviceError: not connected, protocol error, transfer error, time-out, not controller.
CONNECTION_ERRORS: Final = (2, 3, 4, 5, 10)

_Pointer = ctypes.c_void_p
_Text = ctypes.c_char_p


class _GError(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", ctypes.c_int), ("message", ctypes.c_char_p))


@dataclass(frozen=True, slots=True)
class ListedDevice:
    """A camera that Aravis sees: the name to open it by, and what it says about itself."""

    name: str
    vendor: str
    model: str
    serial: str
    address: str


class Aravis:
    """The loaded library."""

    def __init__(self) -> None:
        self._aravis, self._glib = ctypes.CDLL(LIBRARY), ctypes.CDLL("libglib-2.0.so.0")
        self._gobject = ctypes.CDLL("libgobject-2.0.so.0")
        self._functions: dict[str, Any] = {}
        self._glib.g_error_free.argtypes = [_Pointer]
        self._glib.g_free.argtypes = [_Pointer]
        self._gobject.g_object_unref.argtypes = [_Pointer]
        self._device_error = ctypes.c_uint32(self.plain("arv_device_error_quark", ctypes.c_uint32)()).value

    def plain(self, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        """Return a function that reports no error."""
        if name not in self._functions:
            function = getattr(self._aravis, name)
            function.restype, function.argtypes = result, list(arguments)
            self._functions[name] = function
        found: Callable[..., Any] = self._functions[name]
        return found

    def checked(self, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        """Return a function whose GError becomes a :class:`FeatureError`."""
        function = self.plain(name, result, *arguments, ctypes.POINTER(ctypes.POINTER(_GError)))

        def call(*given: Any) -> Any:
            error = ctypes.POINTER(_GError)()
            answer = function(*given, ctypes.byref(error))
            if error:
                text = (error.contents.message or b"").decode(errors="replace")
                broken = error.contents.domain == self._device_error and error.contents.code in CONNECTION_ERRORS
                self._glib.g_error_free(error)
                raise (ConnectionBrokenError if broken else FeatureError)(text)
            return answer

        return call

    def release(self, pointer: int) -> None:
        """Give up a reference to an object."""
        self._gobject.g_object_unref(pointer)

    def free(self, pointer: int) -> None:
        """Free memory that the library allocated."""
        self._glib.g_free(pointer)

    def devices(self) -> tuple[ListedDevice, ...]:
        """List the cameras in reach; takes about a second."""
        self.plain("arv_update_device_list", None)()
        number = self.plain("arv_get_n_devices", ctypes.c_uint)()
        asked = ("id", "vendor", "model", "serial_nbr", "address")
        functions = [self.plain(f"arv_get_device_{what}", _Text, ctypes.c_uint) for what in asked]
        return tuple(
            ListedDevice(*((get(i) or b"").decode(errors="replace") for get in functions)) for i in range(number)
        )


@cache
def load_aravis() -> Aravis:
    """Load the library.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    try:
        return Aravis()
    except OSError as error:
        raise MissingExtraError(
            f"camera driver 'aravis' needs the system library {LIBRARY} ({error}); install it with "
            "'apt-get install --no-install-recommends libaravis-0.8-0'"
        ) from None
