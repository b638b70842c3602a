"""Aravis' own fake GigE Vision camera (class ArvGvFakeCamera of libaravis) as a process.

The program arv-fake-gv-camera-0.8 is a shell around this class; Debian's aravis-tools-cli 0.8.26 leaves it out.

Usage: python fake_gigevision_camera.py INTERFACE SERIAL LOST_PACKETS_PER_THOUSAND
"""

import ctypes
import fcntl
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.capture.drivers.programs import wait_until

CONTROL_PORT = 3956
SERIAL = "FINRAY01"
PORT_IS_FREE_WITHIN_S = 120.0


class FakeCamera:
    """The camera process; it can be killed and started again."""

    def __init__(self, lost_per_thousand: int = 0) -> None:
        self._lost = lost_per_thousand
        self.start()

    def start(self) -> None:
        wait_until(lambda: not _is_bound(CONTROL_PORT), f"port {CONTROL_PORT}")
        self.process = subprocess.Popen([sys.executable, __file__, "127.0.0.1", SERIAL, str(self._lost)])
        wait_until(lambda: _is_bound(CONTROL_PORT), "Aravis' fake camera")

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


@contextmanager
def fake_camera(lost_per_thousand: int = 0) -> Iterator[FakeCamera]:
    """Run the camera for a ``with`` block; its port is fixed, so that only one runs at a time."""
    with (Path(tempfile.gettempdir()) / f"gigevision-{CONTROL_PORT}.lock").open("w") as lock:
        wait_until(lambda: _locks(lock.fileno()), "the lock of the camera's port", PORT_IS_FREE_WITHIN_S)
        camera = FakeCamera(lost_per_thousand)
        try:
            yield camera
        finally:
            camera.kill()


def _locks(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_bound(port: int) -> bool:
    """Whether a UDP socket of the loopback has this port."""
    return f"0100007F:{port:04X}" in Path("/proc/net/udp").read_text(encoding="ascii")


def main(interface: str, serial: str, lost_per_thousand: str) -> None:
    """Run until killed."""
    aravis, gobject = ctypes.CDLL("libaravis-0.8.so.0"), ctypes.CDLL("libgobject-2.0.so.0")
    aravis.arv_gv_fake_camera_new.restype = ctypes.c_void_p
    aravis.arv_gv_fake_camera_new.argtypes = [ctypes.c_char_p, ctypes.c_char_p]
    aravis.arv_gv_fake_camera_is_running.argtypes = [ctypes.c_void_p]
    camera = aravis.arv_gv_fake_camera_new(interface.encode(), serial.encode())
    gobject.g_object_set.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_double, ctypes.c_void_p]
    gobject.g_object_set.restype = None
    gobject.g_object_set(camera, b"gvsp-lost-ratio", 1e-3 * float(lost_per_thousand), None)
    if not aravis.arv_gv_fake_camera_is_running(camera):
        sys.exit(f"the fake camera does not run: is port {CONTROL_PORT} in use?")
    signal.pause()


if __name__ == "__main__":
    main(*sys.argv[1:])
