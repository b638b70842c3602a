"""Exchange frames of bytes with devices, each with a deadline: serial ports, HTTP, INDI, Alpaca, MJPEG.

A wait ends when the answer is complete or at an instant of :func:`time.monotonic`, whichever comes first. A lost
connection is reported once, and the next call connects again. Every message has a largest length.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from rigs.transports._alpaca_client import (
        ALPACA_OPENS_WITHIN_S,
        AlpacaClient,
        alpaca_address,
        alpaca_devices,
        device_number,
    )
    from rigs.transports._indi_client import (
        CAMERA_INTERFACE,
        FILTER_WHEEL_INTERFACE,
        INDI_OPENS_WITHIN_S,
        LIGHT_INTERFACE,
        IndiClient,
        IndiProperty,
        indi_address,
        local_indi_devices,
    )
    from rigs.transports._indi_messages import blob_bytes, new_vector
    from rigs.transports._repeated_exchange import (
        RECOVERS_WITHIN_S,
        Fault,
        fault_listener,
        repeated,
        report_fault,
        require_same_board,
    )
    from rigs.transports._serial_link import LATENCY_S, BoardClock, SerialLink, line_crc8, port_advice, usb_serial_ports
    from rigs.transports._timed_http import MultipartStream, NewestPart, Part, TimedConnection
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "ALPACA_OPENS_WITHIN_S",
    "CAMERA_INTERFACE",
    "FILTER_WHEEL_INTERFACE",
    "INDI_OPENS_WITHIN_S",
    "LATENCY_S",
    "LIGHT_INTERFACE",
    "RECOVERS_WITHIN_S",
    "AlpacaClient",
    "BoardClock",
    "Fault",
    "IndiClient",
    "IndiProperty",
    "MultipartStream",
    "NewestPart",
    "Part",
    "SerialLink",
    "TimedConnection",
    "alpaca_address",
    "alpaca_devices",
    "blob_bytes",
    "device_number",
    "fault_listener",
    "indi_address",
    "line_crc8",
    "local_indi_devices",
    "new_vector",
    "port_advice",
    "repeated",
    "report_fault",
    "require_same_board",
    "usb_serial_ports",
]
