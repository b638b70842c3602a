"""The watch of a light: a third process with a line of its own to the light, which says "off" when another is missing.

The guard starts it as ``python -I -S watch.py SOCKET OWNER_PID NAME SUCCESSOR...``. It is one thread with few imports
and no garbage collection, so that nothing delays it: while the light is lit it looks every 20 ms whether owner and
guard are there and run, and whether the owner's lease holds. When not, it sends the literal "off" words of the driver,
at once and again, for an "on" may be under way. If nobody else is left it ends as SUCCESSOR, which confirms "off".

The guard says to it, each in a packet of its own: ``arm UNTIL_S [HOST PORT]`` with the words after a line feed (and a
descriptor of the light's line where no HOST is), ``lease UNTIL_S``, ``alive``, ``drop``, ``dark``, ``end``. It answers
``armed`` or ``no REASON``, and tells ``fired REASON``. Instants are those of :func:`time.monotonic`.
"""

import gc
import os
import select
import socket
import sys
import time

LOOK_S = 0.02
"""How often each of the three looks for the others while the light is lit."""
LOOK_IN_THE_DARK_S = 0.5
GUARD_SILENT_S = 5.0
"""A guard that says nothing for so long hangs, though its process runs; it says something twice a second."""
REPEAT_S = 0.2
REPEAT_FOR_S = 2.0
"""A server whose "on" nobody confirmed may carry it out so late."""
REPEAT_ON_DESCRIPTOR_FOR_S = 0.4
"""A serial line keeps the order of what is sent; until it is let go, nobody else can open the port."""
CONNECT_WITHIN_S = 0.5
LONGEST_PACKET_BYTES = 65536
SIGKILL = 9  # signal is one more module to load


class OtherProcess:
    """Another process, held by descriptors: a number that is given to a new process deceives nobody.

    Parameters
    ----------
    pid
        Its number; the process must be running.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._stat = os.open(f"/proc/{pid}/stat", os.O_RDONLY | os.O_CLOEXEC)
        # Wakes a poll at once; Pythons built for old kernels lack it, some containers forbid it: the next look tells.
        self._pidfd: int | None = None
        if hasattr(os, "pidfd_open"):
            try:  # noqa: SIM105 - contextlib is one more module to load
                self._pidfd = os.pidfd_open(pid)
            except OSError:
                pass

    @property
    def descriptors(self) -> list[int]:
        """What becomes readable when the process ends."""
        return [] if self._pidfd is None else [self._pidfd]

    def missing(self) -> str:
        """Return "is gone" or "was stopped"; empty when the process runs or could."""
        try:
            state = os.pread(self._stat, 512, 0).rpartition(b")")[2][1:2]
        except OSError:
            return "is gone"
        if state in (b"T", b"t"):
            return "was stopped"
        return "is gone" if state in (b"Z", b"X", b"x", b"") else ""

    def close(self) -> None:
        """Let go of the descriptors."""
        for descriptor in (self._stat, *self.descriptors):
            os.close(descriptor)


class OffLine:
    """A line to the light that carries the "off" words and nothing else.

    Parameters
    ----------
    words
        What switches off, as the light's controller or server reads it.
    server
        Host and port to connect to.
    descriptor
        The light's open line in the place of a server; this object then owns it.
    """

    def __init__(self, words: bytes, server: "tuple[str, int] | None", descriptor: "int | None" = None) -> None:
        self._words, self._descriptor = words, descriptor
        self._link: socket.socket | None = None
        # Looked up now: a name server that is slow must not delay "off".
        self._found = [] if server is None else socket.getaddrinfo(*server, type=socket.SOCK_STREAM)

    @property
    def repeat_for_s(self) -> float:
        """How long "off" is said again."""
        return REPEAT_FOR_S if self._descriptor is None else REPEAT_ON_DESCRIPTOR_FOR_S

    def try_to_connect(self) -> None:
        """See that a connection is to be had, and hang up; raises OSError."""
        if self._descriptor is None:
            self._connected().close()

    def say_off(self) -> None:
        """Send the words, over a new connection where the last one has ended; raises OSError."""
        if self._descriptor is not None:
            os.write(self._descriptor, self._words)
            return
        if self._link is None:
            self._link = self._connected()
        try:
            self._link.sendall(self._words)
        except OSError:
            self._hang_up()
            raise

    def listen(self, for_s: float) -> None:
        """Take in what the server says: hanging up on unread answers could cost it the words."""
        end_s = time.monotonic() + for_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            if self._link is None:
                time.sleep(left_s)
                continue
            try:
                self._link.settimeout(left_s)
                if not self._link.recv(LONGEST_PACKET_BYTES):
                    self._hang_up()
            except TimeoutError:
                return
            except OSError:
                self._hang_up()

    def close(self) -> None:
        """Let go of the line."""
        self._hang_up()
        if self._descriptor is not None:
            os.close(self._descriptor)

    def _connected(self) -> socket.socket:
        """Connect to the first of the server's addresses that takes us; localhost has two."""
        last = OSError("the server has no address")
        for family, kind, protocol, _, address in self._found:
            try:
                link = socket.socket(family, kind, protocol)
            except OSError as error:  # a computer without IPv6, whose localhost has an address of it all the same
                last = error
                continue
            try:
                link.settimeout(CONNECT_WITHIN_S)
                link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                link.connect(address)
            except OSError as error:
                link.close()
                last = error
            else:
                return link
        raise last

    def _hang_up(self) -> None:
        if self._link is not None:
            self._link.close()
        self._link = None


class Watch:
    """The watch of one light.

    Parameters
    ----------
    guard_line
        Socket to the guard.
    owner, guard
        The two others.
    name
        What the light is and where, for messages.
    """

    def __init__(self, guard_line: socket.socket, owner: OtherProcess, guard: OtherProcess, name: str) -> None:
        self._guard_line, self._owner, self._guard, self._name = guard_line, owner, guard, name
        self._line: OffLine | None = None
        self._is_armed = self.is_over = False
        self._until_s = self._heard_s = time.monotonic()

    def run(self) -> None:
        """Watch until the guard says that it is over, or somebody is missing."""
        poll = select.poll()
        for descriptor in (self._guard_line.fileno(), *self._owner.descriptors, *self._guard.descriptors):
            poll.register(descriptor, select.POLLIN)
        while True:
            poll.poll(1e3 * (LOOK_S if self._is_armed else LOOK_IN_THE_DARK_S))
            why = self._listen() or self._look()
            if self.is_over or (why and not self._is_armed):
                return
            if why:
                self._fire(why)
                return

    @property
    def is_alone(self) -> bool:
        """Whether neither owner nor guard can see to the light."""
        return bool(self._owner.missing() and self._guard.missing())

    def _look(self) -> str:
        """Return why the light must go off now; empty when it need not."""
        for who, process in (("owner", self._owner), ("guard process", self._guard)):
            missing = process.missing()
            if missing == "is gone" or (missing and self._is_armed):
                return f"its {who} {missing}"
        if not self._is_armed:
            return ""
        now_s = time.monotonic()
        if now_s >= self._until_s:
            return "the program that switched it on sent nothing for too long"
        if now_s - self._heard_s >= GUARD_SILENT_S:
            return f"its guard process sent nothing for {GUARD_SILENT_S:g} s"
        return ""

    def _listen(self) -> str:
        """Take in all that the guard has said."""
        while not self.is_over:
            try:
                packet, descriptors, _, _ = socket.recv_fds(self._guard_line, LONGEST_PACKET_BYTES, 1)
            except BlockingIOError:
                return ""
            except OSError:
                packet, descriptors = b"", []
            if not packet:
                return "its guard process has closed the connection"
            self._heard_s = time.monotonic()
            self._obey(packet, descriptors)
        return ""

    def _obey(self, packet: bytes, descriptors: "list[int]") -> None:
        head, _, words = packet.partition(b"\n")
        order, *fields = head.decode().split(" ")
        if order == "arm":
            self._tell(self._arm(fields, words, descriptors))
        elif order == "lease":
            self._until_s = float(fields[0])
        elif order in ("drop", "dark"):
            self._let_go()
            self._is_armed = self._is_armed and order == "drop"
        elif order == "end":
            self._let_go()
            self.is_over = True

    def _arm(self, fields: "list[str]", words: bytes, descriptors: "list[int]") -> str:
        """Take over the line and the words; return "armed", or why not."""
        self._let_go()
        try:
            if descriptors:
                self._line = OffLine(words, None, descriptors[0])
            else:
                self._line = OffLine(words, (fields[1], int(fields[2])))
                self._line.try_to_connect()
        except OSError as error:
            return f"no {error.strerror or error}"
        for who, process in (("owner", self._owner), ("guard process", self._guard)):
            if missing := process.missing():
                return f"no its {who} {missing}"
        self._until_s, self._is_armed = float(fields[0]), True
        return "armed"

    def _fire(self, why: str) -> None:
        """Say "off", at once and again and again, until it is repeated enough or the guard has confirmed it."""
        began_s = time.monotonic()
        while self._line is not None:
            why_not = ""
            try:
                self._line.say_off()
            except OSError as error:
                why_not = error.strerror or str(error)
            self._tell(f"fired {why}")
            self._line.listen(REPEAT_S)
            if time.monotonic() - began_s >= self._line.repeat_for_s:
                if why_not:
                    shout(f"{self._name}: the watch could not send the command to switch off ({why_not})")
                self._let_go()
            self._listen()

    def _let_go(self) -> None:
        if self._line is not None:
            self._line.close()
        self._line = None

    def _tell(self, text: str) -> None:
        try:  # noqa: SIM105 - contextlib is one more module to load
            self._guard_line.send(text.encode(), socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except OSError:
            pass  # a guard that is gone, or frozen, hears nothing


def shout(text: str) -> None:
    """Tell whoever is at the terminal, if somebody is."""
    try:  # noqa: SIM105 - contextlib is one more module to load
        os.write(2, f"\n{text}\n".encode())
    except OSError:
        pass


def main(arguments: "list[str]") -> None:
    """Watch over the light that the arguments name."""
    gc.disable()
    descriptor, owner_pid, name, *successor = arguments
    with socket.socket(fileno=int(descriptor)) as guard_line:
        guard_line.setblocking(False)
        owner, guard = OtherProcess(int(owner_pid)), OtherProcess(os.getppid())
        watch = Watch(guard_line, owner, guard, name)
        watch.run()
        if watch.is_over or not watch.is_alone:
            return
    if guard.missing() == "was stopped":
        try:
            os.kill(guard.pid, SIGKILL)  # it holds the light's line; a stopped owner is left for its user
        except OSError as error:  # it has ended meanwhile, or the successor will find the line taken and say so
            shout(f"{name}: the stopped guard process could not be ended ({error.strerror})")
    try:
        os.execv(successor[0], successor)
    except OSError as error:
        shout(f"{name}: OFF WAS SENT AND IS NOT CONFIRMED ({error.strerror}). LOOK BEFORE ANYONE OPENS THE BOX.")


if __name__ == "__main__":
    main(sys.argv[1:])
