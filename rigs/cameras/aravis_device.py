"""A camera and its stream of frames through Aravis' functions; buffers that are pushed belong to the stream."""

import ctypes
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from rigs.cameras.aravis_library import Aravis
from rigs.cameras.genicam import ConnectionBrokenError, FeatureError
from rigs.cameras.genicam_device import Delivered

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

    def next_buffer(self, limit_s: float) -> Delivered | None:
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

    def _copied(self, buffer: int) -> Delivered:
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
        return Delivered(
            fault="" if status == SUCCESS else status,
            frame_id=int(plain("arv_buffer_get_frame_id", ctypes.c_uint64, _Pointer)(buffer)),
            device_time_s=plain("arv_buffer_get_timestamp", ctypes.c_uint64, _Pointer)(buffer) / NS_PER_S,
            width_px=width_px,
            height_px=height_px,
            content=content,
        )
