"""GenICam cameras through Aravis: USB3 Vision and GigE Vision.

The library is loaded through ctypes. Two facts of libaravis 0.8: a call with an error to report fills a GError, and
buffers that are pushed belong to the stream.
"""

import ctypes
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from functools import cache
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final

import numpy as np

from data_schemas import CameraSettings, DeviceIdentity, LostError, MissingExtraError, RefusedError
from rigs.cameras._genicam import (
    ConnectionBrokenError,
    DeliveredFrame,
    FeatureError,
    GenicamCamera,
    firmware_of,
    name_of,
    opened_camera,
)

LIBRARY: Final = "libaravis-0.8.so.0"
# ArvDeviceError: not connected, protocol error, transfer error, time-out, not controller.
CONNECTION_ERRORS: Final = (2, 3, 4, 5, 10)


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


SUCCESS: Final = "success"
STATUS: Final = {
    -1: "unknown",
    0: SUCCESS,
    1: "cleared",
    2: "timeout",
    3: "missing packets",
    4: "wrong packet id",
    5: "size mismatch",
    6: "filling",
    7: "aborted",
    8: "payload not supported",
}
NS_PER_S: Final = 1e9

_Pointer = ctypes.c_void_p
_Text = ctypes.c_char_p
_Number = ctypes.c_double
_Integer = ctypes.c_int64
_Flag = ctypes.c_int


class AravisDevice:
    """An open camera and its features.

    Parameters
    ----------
    library
        The loaded library.
    name
        The camera's name or IP address.
    """

    def __init__(self, library: Aravis, name: str) -> None:
        self._library = library
        self._pointer = library.checked("arv_camera_new", _Pointer, _Text)(name.encode())

    def has(self, name: str) -> bool:
        """Return whether the camera has this feature now."""
        return bool(self._named("is_feature_available", _Flag)(self._pointer, name.encode()))

    def entries(self, name: str) -> tuple[str, ...]:
        """Return what an enumeration can be set to."""
        number = ctypes.c_uint()
        get = self._library.checked(
            "arv_camera_dup_available_enumerations_as_strings",
            ctypes.POINTER(_Text),
            _Pointer,
            _Text,
            ctypes.POINTER(ctypes.c_uint),
        )
        array = get(self._pointer, name.encode(), ctypes.byref(number))
        found = tuple(array[i].decode() for i in range(number.value))
        self._library.free(ctypes.cast(array, _Pointer))  # type: ignore[arg-type]
        return found

    def text(self, name: str) -> str:
        """Read an enumeration or string."""
        found: bytes | None = self._named("get_string", _Text)(self._pointer, name.encode())
        return (found or b"").decode(errors="replace")

    def number(self, name: str) -> float:
        """Read a number."""
        try:
            return float(self._named("get_float", _Number)(self._pointer, name.encode()))
        except ConnectionBrokenError:
            raise
        except FeatureError:  # an integer is no float to Aravis
            return float(self._named("get_integer", _Integer)(self._pointer, name.encode()))

    def is_on(self, name: str) -> bool:
        """Read a switch."""
        return bool(self._named("get_boolean", _Flag)(self._pointer, name.encode()))

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the smallest and largest value of a number."""
        try:
            return self._bounds("get_float_bounds", name, _Number)
        except ConnectionBrokenError:
            raise
        except FeatureError:
            return self._bounds("get_integer_bounds", name, _Integer)

    def set_text(self, name: str, value: str) -> None:
        """Write an enumeration or string."""
        self._named("set_string", None, _Text)(self._pointer, name.encode(), value.encode())

    def set_number(self, name: str, value: float) -> None:
        """Write a number."""
        try:
            self._named("set_float", None, _Number)(self._pointer, name.encode(), float(value))
        except ConnectionBrokenError:
            raise
        except FeatureError:
            self._named("set_integer", None, _Integer)(self._pointer, name.encode(), round(value))

    def switch(self, name: str, on: bool) -> None:
        """Write a switch."""
        self._named("set_boolean", None, _Flag)(self._pointer, name.encode(), int(on))

    def execute(self, command: str) -> None:
        """Execute a command such as AcquisitionStart."""
        self._named("execute_command", None)(self._pointer, command.encode())

    def about(self, what: str) -> str:
        """Return what the camera says it is: vendor_name, model_name or device_serial_number."""
        found = self._library.checked(f"arv_camera_get_{what}", _Text, _Pointer)(self._pointer)
        return (found or b"").decode(errors="replace")

    def stream(self) -> "AravisStream":
        """Open a stream of frames with the settings of now."""
        size = int(self._library.checked("arv_camera_get_payload", ctypes.c_uint, _Pointer)(self._pointer))
        create = self._library.checked("arv_camera_create_stream", _Pointer, _Pointer, _Pointer, _Pointer)
        return AravisStream(self._library, create(self._pointer, None, None), size)

    def close(self) -> None:
        """Close the connection."""
        self._library.release(self._pointer)

    def _named(self, what: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        """Return a function of a camera that takes the name of a feature."""
        return self._library.checked(f"arv_camera_{what}", result, _Pointer, _Text, *arguments)

    def _bounds(self, what: str, name: str, number_type: Any) -> tuple[float, float]:
        low, high = number_type(), number_type()
        kind = ctypes.POINTER(number_type)
        self._named(what, None, kind, kind)(self._pointer, name.encode(), ctypes.byref(low), ctypes.byref(high))
        return float(low.value), float(high.value)


class AravisStream:
    """A stream of frames with no buffer of its own: what is not asked for is not kept."""

    def __init__(self, library: Aravis, pointer: int, payload_bytes: int) -> None:
        self._library, self._pointer, self._payload_bytes = library, pointer, payload_bytes

    def offer_buffer(self) -> None:
        """Let the next frame be received."""
        buffer = self._library.plain("arv_buffer_new_allocate", _Pointer, ctypes.c_size_t)(self._payload_bytes)
        self._library.plain("arv_stream_push_buffer", None, _Pointer, _Pointer)(self._pointer, buffer)

    def next_buffer(self, limit_s: float) -> DeliveredFrame | None:
        """Return the frame that fills the offered buffer, or None after `limit_s` seconds."""
        pop = self._library.plain("arv_stream_timeout_pop_buffer", _Pointer, _Pointer, ctypes.c_uint64)
        buffer = pop(self._pointer, max(int(1e6 * limit_s), 0))
        if not buffer:
            return None
        try:
            return self._copied(buffer)
        finally:
            self._library.release(buffer)

    def close(self) -> None:
        """End the stream and free its buffers."""
        self._library.release(self._pointer)

    def _copied(self, buffer: int) -> DeliveredFrame:
        """Copy what a buffer holds; the bytes only of a whole frame."""
        plain = self._library.plain
        status = STATUS.get(plain("arv_buffer_get_status", ctypes.c_int, _Pointer)(buffer), "unknown")
        content = np.empty(0, dtype=np.uint8)
        width_px = height_px = 0
        if status == SUCCESS:
            size = ctypes.c_size_t()
            get = plain("arv_buffer_get_data", _Pointer, _Pointer, ctypes.POINTER(ctypes.c_size_t))
            start = get(buffer, ctypes.byref(size))
            content = np.frombuffer(ctypes.string_at(start, size.value), dtype=np.uint8)
            width_px = int(plain("arv_buffer_get_image_width", ctypes.c_int, _Pointer)(buffer))
            height_px = int(plain("arv_buffer_get_image_height", ctypes.c_int, _Pointer)(buffer))
        return DeliveredFrame(
            fault="" if status == SUCCESS else status,
            frame_id=int(plain("arv_buffer_get_frame_id", ctypes.c_uint64, _Pointer)(buffer)),
            device_time_s=plain("arv_buffer_get_timestamp", ctypes.c_uint64, _Pointer)(buffer) / NS_PER_S,
            width_px=width_px,
            height_px=height_px,
            content=content,
        )


# A camera that ignores SingleFrame may be sending its next frame when it is told to stop (2.6 MB take 21 ms on gigabit
# Ethernet); what is left of it must not meet the buffer of the next exposure.
SETTLE_S: Final = 0.025


class AravisCamera(AravisDevice):
    """A camera opened by Aravis; a buffer is there only while a frame is wanted.

    Parameters
    ----------
    library
        The loaded Aravis.
    name, address
        Aravis' name of the camera, and its address in the rig file.
    """

    def __init__(self, library: Aravis, name: str, address: str) -> None:
        super().__init__(library, name)
        self._address = address
        self._stream: AravisStream | None = None

    def identity(self) -> DeviceIdentity:
        """Read what the camera is."""
        return DeviceIdentity(
            role="camera",
            driver="aravis",
            address=self._address,
            vendor=self.about("vendor_name"),
            model=self.about("model_name"),
            serial=self.about("device_serial_number"),
            firmware=firmware_of(self),
        )

    def prepare(self) -> None:
        """Open the stream; its buffers have the size of the frames that are set now."""
        self.set_text("AcquisitionMode", "SingleFrame")
        self._stream = self.stream()

    def acquire(self, limit_s: float) -> DeliveredFrame | None:
        """Take one frame."""
        if self._stream is None:
            raise ConnectionBrokenError("the stream is closed")
        self._stream.offer_buffer()
        self.execute("AcquisitionStart")
        delivered = self._stream.next_buffer(limit_s)
        if delivered is not None:
            self.execute("AcquisitionStop")
            time.sleep(SETTLE_S)
        return delivered

    def close(self) -> None:
        """Free the stream, then the camera."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None
        super().close()


def open_camera(settings: CameraSettings, folder: Path) -> AbstractContextManager[GenicamCamera]:
    """Return the camera, open for a ``with`` block; its address is a name, serial number or IP address.

    Raises
    ------
    MissingExtraError
        Aravis is not installed.
    """
    library, address, where = load_aravis(), settings.address, name_of(settings)
    return opened_camera(settings, lambda: AravisCamera(library, _name(library, address, where), address))


def found() -> list[tuple[str, str]]:
    """List the cameras in reach: address, and what each is; takes about a second."""
    return [(d.name, f"{d.vendor} {d.model}, serial {d.serial}, at {d.address}") for d in load_aravis().devices()]


def _name(library: Aravis, address: str, where: str) -> str:
    """Return the name by which Aravis opens the camera of the rig file."""
    with suppress(ValueError):
        return str(ip_address(address))
    listed = library.devices()
    names = [d.name for d in listed if address in (d.name, d.serial, d.model)]
    if len(names) == 1:
        return names[0]
    seen = ", ".join(f"{d.name} ({d.model}, serial {d.serial})" for d in listed) or "no camera at all"
    if names:
        raise RefusedError(
            f"{where}: this address fits several cameras (Aravis sees {seen}); give the serial number of one camera "
            "as the address in the rig file"
        )
    raise LostError(
        f"{where}: was not found (Aravis sees {seen}); check cable and power, the access rights of the USB device on "
        "Linux, and the address in the rig file (a camera's name, serial number or IP address)"
    )
