"""A light behind its guard, as the program that owns it sees both: asking, and what follows when the guard is gone.

Three processes cover the death and the freezing of each other. A computer that hangs, a cable that is pulled, or all
three killed at once leaves a light on, unless hardware switches it off: a dead-man in the controller, an interlock, a
relay that opens unless it is pulsed. Lasers of class 3R and above are not lit without such an outside layer.
"""

import contextlib
import datetime
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final, Literal

from data_schemas import (
    CaptureError,
    DeviceIdentity,
    FinrayError,
    LampSettings,
    LaserSettings,
    LostError,
    OutsideLayer,
    RefusedError,
    TimedOutError,
    UnsafeError,
)
from rigs.light_guard._reconnecting_light import (
    EXIT_OFF,
    NOBODY_ASKED,
    HungUpError,
    LightLostError,
    ReconnectingLight,
    channel,
    error_from,
    receive,
    send,
)
from rigs.light_guard.watch import LOOK_IN_THE_DARK_S, LOOK_S, OffLine, OtherProcess
from rigs.transports import RECOVERS_WITHIN_S, Fault, repeated, report_fault

if TYPE_CHECKING:
    from rigs import GuardedSwitch


SWITCH_DEADLINE_S: Final = 5.0
STATE_DEADLINE_S: Final = 2.0
LEASE_S: Final = 300.0
"""A light whose owner asks nothing for so long goes off, where the rig gives no better number."""
GUARD_SILENT_S: Final = 4.5
"""A guard that tries to switch off says so at least this often: opening a port and waiting for a board takes 3.5 s."""
START_WITHIN_S: Final = 45.0
"""Opening a light may take 30 s (INDI), and its driver says better than we what is wrong."""
LEAVE_WITHIN_S: Final = 15.0
END_WITHIN_S: Final = 1.0
ANSWER_MARGIN_S: Final = 0.5
"""What the guard's answer takes beyond the light's."""
RESCUE_ATTEMPT_S: Final = 1.0


class _MustBeReportedError(LightLostError):
    """A light was lost in a way that its user must hear of: no other guard takes its place."""


class GuardClient:
    """A running guard process, as its owner sees it.

    Parameters
    ----------
    role, module, address
        What the light is, the module of its driver and where its controller is.
    lease_s
        An owner that asks nothing for so long hangs, though its process runs: a lit light goes off.
    serial
        Serial number of the light's board, where an earlier guard has learned it: no other is lit.
    """

    def __init__(
        self, role: Literal["laser", "lamp"], module: str, address: str, lease_s: float, serial: str = ""
    ) -> None:
        self.name = f"{role} at {address}"
        self.has_dead_man = False
        self.watch_pid = 0
        self._role, self._module, self._address, self.serial = role, module, address, serial
        self._number, self._lease_s = 0, lease_s
        self._may_be_lit = self._is_on_unanswered = False
        self._ending: FinrayError | None = None
        self._off_line: OffLine | None = None
        self._end_once = threading.Lock()
        self._channel, theirs = channel()
        # -P: a file of the user's folder must not stand in for a module of ours.
        command = [sys.executable, "-P", "-m", "rigs.light_guard.guard_process", str(theirs.fileno())]
        with theirs:
            self._guard = subprocess.Popen(
                [*command, str(os.getpid()), role, self._module, address],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self._process = OtherProcess(self._guard.pid)
        self._watch: OtherProcess | None = None
        self._closing, self._close_it = socket.socketpair()
        self._looker = threading.Thread(target=self._look_after_guard, name=f"guard of {self.name}", daemon=True)

    @property
    def pid(self) -> int:
        """Process number of the guard."""
        return self._guard.pid

    @property
    def has_ended(self) -> bool:
        """Whether the guard is gone and the light confirmed off without it."""
        return isinstance(self._ending, LightLostError)

    @property
    def came_on_by_itself(self) -> bool:
        """Whether it has ended because the light was on in the dark."""
        return self._ending is not None and NOBODY_ASKED in str(self._ending)

    def open(self) -> None:
        """Wait until the guard has opened the light and it is confirmed off."""
        while "ready" not in (message := self._listen(START_WITHIN_S)):
            if "error" in message:
                self._ending = error_from(message)
                raise self._ending
        self.has_dead_man = bool(message["has_dead_man"])
        self.watch_pid = int(message["watch_pid"])
        with contextlib.suppress(OSError):  # it has gone already, and the guard goes too
            self._watch = OtherProcess(self.watch_pid)
        import_module(self._module)  # now, so that a rescue loses no time with it
        self._looker.start()

    def close(self) -> None:
        """End the guard; it switches off once more.

        Raises
        ------
        UnsafeError
            The light is not confirmed off.
        """
        self._close_it.close()
        if self._looker.ident is not None:
            self._looker.join()
        self._closing.close()
        with self._channel:
            with contextlib.suppress(OSError):
                self._channel.shutdown(socket.SHUT_WR)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._guard.wait(LEAVE_WITHIN_S)
            is_off = self._guard.poll() == EXIT_OFF
            error = None if is_off else self._end()
            for end in (self._process, self._watch, self._off_line):
                if end is not None:
                    end.close()
            self._watch = None
            if isinstance(error, UnsafeError):
                raise error

    def ask(self, ask: str, deadline_s: float) -> Any:
        """Have the guard do something and return its answer.

        Raises
        ------
        CaptureError
            What the light's driver raised.
        TimedOutError
            The guard did not answer.
        LostError
            The guard process is gone; the light is confirmed off.
        UnsafeError
            The guard process is gone, and the light is not confirmed off.
        """
        self._number += 1
        number = self._number
        if ask in ("on", "prove the dead-man"):
            self._is_on_unanswered = self._may_be_lit = True
            with contextlib.suppress(OSError):  # nobody looks after a guard that has ended
                self._close_it.send(b"\n")  # it looks more often from now on, not after its long pause in the dark
        self._say(number=number, ask=ask, deadline_s=deadline_s, lease_s=self._lease_s, serial=self.serial)
        while True:
            message = self._listen(max(deadline_s + ANSWER_MARGIN_S, GUARD_SILENT_S))
            if message.get("number") != number:
                continue  # it tries again, or an interrupted question is answered now
            self.serial = str(message.get("serial", self.serial))
            if "error" not in message and ask in ("on", "off", "prove the dead-man"):
                self._is_on_unanswered = False
                self._may_be_lit = ask == "on" or message["value"] is not None
            not_off = ask in ("off", "prove the dead-man") and message.get("value") is not None
            if not not_off and message.get("error") != "UnsafeError":  # these say more than what faults have cost
                for fault in message.get("faults", ()):
                    report_fault(Fault(*fault))
            if "error" in message:
                raise error_from(message)
            if ask == "on" and message["value"] is not None and self._off_line is None:
                host, port, words = message["value"]
                with contextlib.suppress(OSError):  # a rescue opens the light anew
                    self._off_line = OffLine(words.encode("latin-1"), (host, port))
            return message["value"]

    def switch_off(self) -> None:
        """Have the light switched off; a guard that does not answer is killed and replaced by ourselves.

        Raises
        ------
        LostError
            The guard process is gone; the light is confirmed off.
        UnsafeError
            The light is not confirmed off.
        """
        try:
            why_not = self.ask("off", SWITCH_DEADLINE_S)
        except TimedOutError as error:
            self._guard.kill()
            raise self._end() from error
        if why_not is not None:
            raise UnsafeError(self.unconfirmed(str(why_not)))

    def _say(self, **message: object) -> None:
        try:
            send(self._channel, sent_s=time.monotonic(), **message)
        except HungUpError as error:
            raise self._end() from error
        except BlockingIOError as error:
            raise TimedOutError(f"{self.name}: its guard process is frozen") from error

    def _listen(self, within_s: float) -> dict[str, Any]:
        try:
            message = receive(self._channel, time.monotonic() + within_s)
        except HungUpError as error:
            raise self._end() from error
        except TimeoutError as error:
            raise TimedOutError(f"{self.name}: its guard process sent nothing for {within_s:g} s") from error
        if "gone" in message:
            raise self._end(message)
        return message

    def _look_after_guard(self) -> None:
        """Switch off ourselves, at once, when the guard is gone or stopped: the watch may be gone as well."""
        poll = select.poll()
        for descriptor in (self._closing.fileno(), *self._process.descriptors):
            poll.register(descriptor, select.POLLIN)
        while True:
            ended = poll.poll(1e3 * (LOOK_S if self._may_be_lit else LOOK_IN_THE_DARK_S))
            if self._closing.fileno() in dict(ended) and not self._closing.recv(64):
                return
            if self._process.missing():
                self._end()
                return

    def _end(self, farewell: dict[str, Any] | None = None) -> FinrayError:
        """Make sure that the guard is gone and the light off; return the error that tells it, the same every time."""
        with self._end_once:
            if self._ending is None:
                self._ending = self._find_ending(farewell or self._farewell())
            return self._ending

    def _farewell(self) -> dict[str, Any]:
        """Return the guard's last message, if it left one unread."""
        with contextlib.suppress(HungUpError, TimeoutError):
            while True:
                message = receive(self._channel, time.monotonic())
                if "gone" in message:
                    return message
        return {}

    def _find_ending(self, farewell: dict[str, Any]) -> FinrayError:
        end_s = time.monotonic() + END_WITHIN_S
        if self._may_be_lit and self._off_line is not None:
            with contextlib.suppress(OSError):  # the rescue opens the light and confirms it, which takes longer
                self._off_line.say_off()
        # One that has hung up or said farewell ends by itself; one that is stopped does not.
        while self._guard.poll() is None and not self._process.missing() and time.monotonic() < end_s:
            time.sleep(LOOK_S)
        if self._guard.poll() is None:
            self._guard.kill()
            self._guard.wait()
        if self._watch is not None and self._watch.missing() == "was stopped":
            os.kill(self._watch.pid, signal.SIGKILL)  # it may hold the port that is to be opened
        status = self._guard.returncode
        if farewell.get("not_off") is not None:
            return UnsafeError(self.unconfirmed(farewell["not_off"]))
        died = f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        reason = farewell.get("gone", died)
        if status == EXIT_OFF:
            # Whoever told the guard to end wants no light: then nobody lights it anew.
            return (CaptureError if farewell.get("was_told") else LightLostError)(
                f"{self.name}: the guard process has ended ({reason}) after it had confirmed that the light "
                "is off. Continue the capture with --resume"
            )
        if (why_not := self._rescue()) is not None:
            return UnsafeError(
                self.unconfirmed(
                    f"the guard process has ended ({reason}), and switching the light off without it failed: {why_not}"
                )
            )
        return LightLostError(
            f"{self.name}: the guard process has ended ({reason}); the light has been switched off without it and is "
            "confirmed off. Continue the capture with --resume"
        )

    def _rescue(self) -> str | None:
        """Switch off over a connection of our own, now that the guard's is free; return why it does not go off."""

        def opening() -> "AbstractContextManager[GuardedSwitch]":
            switch: AbstractContextManager[GuardedSwitch]
            switch = import_module(self._module).open_switch(self._address, self._role, None)
            return switch

        light = ReconnectingLight(opening, self.name)
        if self._is_on_unanswered:
            light.expect_late_on()
        try:
            return light.make_off(RESCUE_ATTEMPT_S, lambda word: None)
        finally:
            light.close()

    def unconfirmed(self, why: str) -> str:
        """Return what must be done about a light that is not confirmed off."""
        dead_man = (
            " Its dead-man switches it off within 0.5 s of the last message that it received, but that cannot be "
            "read back."
            if self.has_dead_man
            else ""
        )
        todo = "pull its plug before anyone opens the box"
        return f"{self.name}: NOT CONFIRMED OFF; {todo}.{dead_man} The cause: {why}"


class GuardedLight:
    """A light whose connection a guard process holds; open one with :func:`guarded_light`.

    Parameters
    ----------
    role, driver, address
        What the light is, the name of its driver and where its controller is.
    lease_s
        The light goes off when nothing is asked for so long in a lit block: the program hangs. Asking for the state
        renews it, as every exposure does.
    laser
        What the rig file says about a laser. One of class 3R or above goes on only with a layer outside the computer.
    """

    def __init__(
        self,
        role: Literal["laser", "lamp"],
        driver: str,
        address: str,
        lease_s: float = LEASE_S,
        laser: LaserSettings | None = None,
    ) -> None:
        self._start = partial(GuardClient, role, _driver_of_light(driver).__name__, address, lease_s)
        self._guard = self._start()
        self._laser = laser
        self._depth = 0
        self._is_dead_man_proven = self._is_closed = False

    def open(self) -> None:
        """Wait until the guard has opened the light and it is confirmed off.

        Raises
        ------
        CaptureError
            The light cannot be reached.
        UnsafeError
            The light is not confirmed off.
        """
        self._guard.open()

    def close(self) -> None:
        """End the guard; it switches off once more.

        Raises
        ------
        UnsafeError
            The light is not confirmed off.
        """
        self._is_closed = True
        self._guard.close()

    @property
    def guard_pid(self) -> int:
        """Process number of the guard."""
        return self._guard.pid

    @property
    def watch_pid(self) -> int:
        """Process number of the watch."""
        return self._guard.watch_pid

    @property
    def has_dead_man(self) -> bool:
        """Whether the controller itself switches off when it hears nothing for half a second."""
        return self._guard.has_dead_man

    @property
    def outside_layer(self) -> OutsideLayer | None:
        """What the rig file declares to switch it off outside the computer."""
        return None if self._laser is None else self._laser.outside_layer

    @property
    def refusal(self) -> str | None:
        """Why it cannot be lit: a laser of class 3R or above without a layer outside the computer."""
        return None if self._laser is None else refusal(self._laser, self.has_dead_man)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know about the light before it goes on."""
        if self.has_dead_man:
            return ()
        return (f"{self._guard.name}: {off_lines(self.has_dead_man, self.outside_layer)[1]}",)

    def identity(self) -> DeviceIdentity:
        """Ask the controller what it is."""
        return DeviceIdentity.model_validate(self._asked("identity"))

    def state(self) -> bool:
        """Ask the controller whether the light is on.

        Raises
        ------
        LightLostError
            It went off in a lit block; it is confirmed off.
        TimedOutError, LostError
            It cannot be asked.
        """
        return bool(self._asked("state"))

    def _asked(self, ask: Literal["identity", "state"]) -> Any:
        """Return the answer to a question, repeated after faults: in the dark also by a new guard."""

        def attempt(end_s: float) -> Any:
            if not self._depth:
                self._replace_guard()
            try:
                return self._guard.ask(ask, STATE_DEADLINE_S)
            except LightLostError as error:
                raise (_MustBeReportedError(str(error)) if self._must_be_reported else error) from error

        # In a lit block a light that is gone must be lit anew, which whoever needs it decides.
        final = (LightLostError,) if self._depth else (_MustBeReportedError,)
        return repeated(attempt, time.monotonic() + RECOVERS_WITHIN_S, self._guard.name, final=final)

    @property
    def _must_be_reported(self) -> bool:
        """Whether the guard ended so that no other one may take its place: closed, or the light came on by itself."""
        return self._is_closed or self._guard.came_on_by_itself

    def _replace_guard(self) -> None:
        """Start another guard where the last one has ended with the light confirmed off."""
        if not self._guard.has_ended or self._must_be_reported:
            return
        self._guard.close()
        self._guard, self._is_dead_man_proven = self._start(serial=self._guard.serial), False
        self._guard.open()

    @contextmanager
    def lit(self) -> Iterator[None]:
        """Switch on for a ``with`` block; on is confirmed before it, off after it. In a lit block nothing changes.

        A laser of class 3R or above whose controller has a dead-man is lit for a moment before the first block: it
        must go off by itself.

        Raises
        ------
        RefusedError
            The laser is of class 3R or above, and no tested layer outside the computer is declared.
        LightLostError
            It did not come on, or the guard process is gone; the light is confirmed off.
        UnsafeError
            The light is not confirmed off.
        """
        if why := self.refusal:
            raise RefusedError(f"{self._guard.name}: {why}")
        if not self._depth:
            self.state()  # asked in the dark, where everything may be opened anew
        self._depth += 1
        try:
            if self._depth == 1:
                self._switch_on()
            yield
        except BaseException:
            # A lost guard means "off" here, and what left the block says more.
            with contextlib.suppress(LostError):
                self._leave()
            raise
        self._leave()

    def _switch_on(self) -> None:
        """Switch on, in one attempt."""
        try:
            self._prove_dead_man()
            self._guard.ask("on", SWITCH_DEADLINE_S)
        except (LostError, TimedOutError) as error:
            raise LightLostError(str(error)) from error

    def _prove_dead_man(self) -> None:
        """See once that the dead-man of a hazardous laser acts."""
        if self._laser is None or self._is_dead_man_proven or not (self.has_dead_man and is_hazardous(self._laser)):
            return
        if (why_not := self._guard.ask("prove the dead-man", SWITCH_DEADLINE_S)) is not None:
            raise UnsafeError(self._guard.unconfirmed(str(why_not)))
        self._is_dead_man_proven = True

    def _leave(self) -> None:
        """Switch off at the end of the outermost block, also when Ctrl-C comes meanwhile."""
        self._depth -= 1
        if self._depth:
            return
        try:
            self._guard.switch_off()
        except KeyboardInterrupt:
            self._guard.switch_off()
            raise


@contextmanager
def guarded_light(
    role: Literal["laser", "lamp"],
    driver: str,
    address: str,
    lease_s: float = LEASE_S,
    laser: LaserSettings | None = None,
) -> Iterator[GuardedLight]:
    """Open a light behind a guard process of its own, for a ``with`` block; it is off before and after.

    Parameters
    ----------
    role
        "laser" or "lamp", for messages.
    driver, address
        As in the rig file.
    lease_s
        The light goes off when nothing is asked for so long in a lit block.
    laser
        What the rig file says about a laser.

    Raises
    ------
    CaptureError
        The light cannot be reached.
    UnsafeError
        The light is not confirmed off.
    """
    light = GuardedLight(role, driver, address, lease_s, laser)
    try:
        light.open()
        yield light
    finally:
        light.close()


HAZARDOUS_CLASSES: Final = ("3R", "3B", "4")
TEST_VALID_DAYS: Final = 90


def is_hazardous(laser: LaserSettings) -> bool:
    """Whether the label says class 3R or above (IEC 60825-1)."""
    return laser.laser_class in HAZARDOUS_CLASSES


def refusal(laser: LaserSettings, has_dead_man: bool, today: datetime.date | None = None) -> str | None:
    """Return why a laser must not go on, with the way out; None when it may.

    Parameters
    ----------
    laser
        What the rig file says.
    has_dead_man
        Whether its driver speaks to a controller with a dead-man, which is tested before the laser is first lit.
    today
        For the age of the test; by the computer's clock when left out.
    """
    layer = laser.outside_layer
    if not is_hazardous(laser) or has_dead_man:
        return None
    if layer is None:
        return (
            f"a class {laser.laser_class} laser is switched on only if hardware outside the computer can switch it "
            "off, because no program can do so when the computer hangs or all processes of finray are killed. Drive it "
            "by an Arduino with our firmware, which has a dead-man, or build an interlock into its supply, or a relay "
            "that opens unless it is pulsed; then test this hardware and declare it in the rig file as "
            "[laser.outside_layer] (docs/how-to/connect-a-laser.md)"
        )
    age_days = ((today or datetime.date.today()) - datetime.date.fromisoformat(layer.tested_on)).days
    if 0 <= age_days <= TEST_VALID_DAYS:
        return None
    when = "in the future" if age_days < 0 else f"{age_days} days ago"
    return (
        f"the test of its outside layer ({layer.kind}) on {layer.tested_on} is {when}, but at most {TEST_VALID_DAYS} "
        f"days are allowed for a class {laser.laser_class} laser; test the {layer.kind} again and correct tested_on "
        "of [laser.outside_layer] in the rig file"
    )


def require_outside_layer(laser: LaserSettings) -> None:
    """Refuse a laser that must not be switched on, before anything is opened.

    Raises
    ------
    RefusedError
        It is of class 3R or above, and nothing outside the computer switches it off.
    """
    if laser.driver != "simulated" and (why := refusal(laser, has_dead_man(laser))):
        raise RefusedError(f"laser at {laser.address}: {why}")


def has_dead_man(settings: LaserSettings | LampSettings) -> bool:
    """Whether the driver of a light speaks to a controller with a dead-man."""
    return bool(_driver_of_light(settings.driver).HAS_DEAD_MAN)


def _driver_of_light(name: str) -> ModuleType:
    """Return the module of a light's driver."""
    # rigs._drivers imports this package; it is looked up when it is there.
    from rigs import driver_module, find_driver

    return driver_module(find_driver("light", name))


def off_lines(has_dead_man: bool, layer: OutsideLayer | None = None) -> tuple[str, str]:
    """Return, in two sentences, what switches a light off when a process fails and when the whole computer does."""
    first = "off when a process of finray is killed or stopped: yes, by the other processes, within 1 s"
    all_of_them = "off when the computer hangs, the light's cable is pulled or all processes are killed"
    if has_dead_man:
        return first, f"{all_of_them}: yes, by the dead-man in the light's controller, within 0.5 s"
    if layer is not None:
        return first, f"{all_of_them}: only by the {layer.kind} (tested on {layer.tested_on}: {layer.test})"
    return first, f"{all_of_them}: NO, the light stays on; it has no dead-man and no other layer outside the computer"


def safety_lines(laser: LaserSettings) -> tuple[str, ...]:
    """Return what everybody in the room must know, with what switches the laser off and what does not."""
    return (
        f"LASER {laser.wavelength_nm:g} nm, {laser.power_mw:g} mW, class {laser.laser_class}: it will be switched on. "
        f"Wear goggles for {laser.wavelength_nm:g} nm, close the box, keep others out",
        *(f"  {line}" for line in off_lines(has_dead_man(laser), laser.outside_layer)),
    )
