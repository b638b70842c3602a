"""A Thorlabs FW212C for the device simulator lewis, with faults that are switched on over its control port.

A command ends with CR; the wheel repeats it, CR, then the value of a query, CR, then the prompt ``> ``. Positions count
from 1. With ``prompt_after_move`` the prompt of ``pos=n`` comes when the move has ended, and what is said meanwhile is
answered after it. Checked from outside: pylablib's driver for this wheel connects, moves it and reads it.
"""

import threading
from collections import OrderedDict

from lewis.adapters.stream import Cmd, StreamInterface
from lewis.core.statemachine import State
from lewis.devices import StateMachineDevice

NAMES = "pos|pcount|trig|speed|sensors|baud"
PROMPT = "> "


class Moving(State):
    def in_state(self, dt):
        wheel = self._context
        if not wheel.stuck:
            wheel.left_s = max(0.0, wheel.left_s - dt)

    def on_exit(self, dt):
        wheel = self._context
        wheel.pos = (wheel.target - 1 + wheel.slip) % wheel.pcount + 1
        wheel.arrive()


class FilterWheel(StateMachineDevice):
    def _initialize_data(self):
        self.idn = "THORLABS FW102C/FW212C Filter Wheel version 1.04"
        self.pcount, self.pos, self.target, self.left_s = 12, 1, 1, 0.0
        self.trig, self.speed, self.sensors, self.baud = 0, 0, 1, 1
        self.step_s, self.prompt_after_move = 0.02, False
        # Faults: stands still, stops so many slots beside, says nothing, repeats wrongly, answers so much later,
        # forgets one setting.
        self.stuck, self.slip, self.mute, self.garble, self.late_s, self.forgets = False, 0, False, False, 0.0, ""
        self.owed = []
        self.say = None

    def _get_state_handlers(self):
        return {"idle": State(), "moving": Moving()}

    def _get_initial_state(self):
        return "idle"

    def _get_transition_handlers(self):
        return OrderedDict(
            [(("idle", "moving"), lambda: self.left_s > 0.0), (("moving", "idle"), lambda: self.left_s <= 0.0)]
        )

    @property
    def holds_its_tongue(self):
        """Whether a move is on and its prompt is still owed."""
        return self.prompt_after_move and self.left_s > 0.0

    def arrive(self):
        """Say what is owed at the end of a move."""
        owed, self.owed = self.owed, []
        if owed:
            self.say("".join(owed), 0.0)


class Wire(StreamInterface):
    in_terminator, out_terminator = "\r", ""
    commands = (
        Cmd("identify", r"^\*idn\?$"),
        Cmd("query", rf"^({NAMES})\?$"),
        Cmd("assign", rf"^({NAMES})=(-?\d+)$"),
        Cmd("save", "^save$"),
    )

    def answer(self, echo, value=None, prompt=PROMPT):
        wheel = self.device
        wheel.say = self.say_later
        if wheel.mute:
            return None
        if wheel.garble:
            echo = "#" + echo[1:]
        said = echo + "\r" + ("" if value is None else f"{value}\r") + prompt
        if wheel.owed:
            wheel.owed.append(said)
            return None
        if wheel.late_s > 0.0:
            self.say_later(said, wheel.late_s)
            return None
        return said

    def say_later(self, said, after_s):
        # From a thread of its own: lewis holds a lock while it runs the device, and saying something waits for it.
        timer = threading.Timer(after_s, self.handler.unsolicited_reply, [said])
        timer.daemon = True
        timer.start()

    def identify(self):
        return self.answer("*idn?", self.device.idn)

    def query(self, name):
        return self.answer(f"{name.decode()}?", getattr(self.device, name.decode()))

    def assign(self, name, value):
        name, value, wheel = name.decode(), int(value), self.device
        if name == "pos":
            return self.move(value)
        if name != wheel.forgets:
            setattr(wheel, name, value)
        return self.answer(f"{name}={value}")

    def move(self, slot):
        wheel = self.device
        if not 1 <= slot <= wheel.pcount:
            return self.answer(f"pos={slot}", "Command error CMD_ARG_INVALID")
        steps = abs(slot - wheel.pos)
        wheel.target, wheel.left_s = slot, min(steps, wheel.pcount - steps) * wheel.step_s
        if not wheel.holds_its_tongue:
            return self.answer(f"pos={slot}")
        said = self.answer(f"pos={slot}", prompt="")
        wheel.owed = [PROMPT]
        return said

    def save(self):
        return self.answer("save")

    def handle_error(self, request, error):
        return self.answer(request.decode("ascii", "replace"), "Command error CMD_NOT_DEFINED")
