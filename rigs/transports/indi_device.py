"""What one device of an INDI server has said: its properties, frames and messages."""

from collections import deque
from dataclasses import dataclass, field
from typing import Final, Literal

from data_schemas.devices import DeviceIdentity
from data_schemas.errors import LostError, RefusedError
from rigs.transports.indi_messages import IndiElement, IndiMessage, number

LONGEST_TEXT: Final = 200
_KEPT_TEXTS: Final = 8


@dataclass(slots=True)
class IndiProperty:
    """What the driver said last about a property; updated in place.

    Attributes
    ----------
    state
        Idle, Ok, Busy or Alert.
    values
        Texts of the members, by name.
    ranges
        Least and greatest value of numbers, by name of the member.
    definitions, settings
        How often the driver has defined and set it in this connection: whoever waits for news compares.
    """

    state: str = "Idle"
    values: dict[str, str] = field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    definitions: int = 0
    settings: int = 0


class IndiDevice:
    """What is known of a device.

    Parameters
    ----------
    device
        Its name in the server.
    name
        Role and address, for messages.
    needed
        Property that the device has while it is connected; without it the device counts as lost.
    """

    def __init__(self, device: str, name: str, needed: str) -> None:
        self.name = name
        self._device, self._needed = device, needed
        self.properties: dict[str, IndiProperty] = {}
        self.blobs: dict[str, IndiElement] = {}
        self._texts: deque[str] = deque(maxlen=_KEPT_TEXTS)

    def property(self, name: str) -> IndiProperty:
        """Return what was said last about a property.

        Raises
        ------
        RefusedError
            The device has no such property.
        """
        if name not in self.properties:
            raise RefusedError(f"{self.name}: has no property {name}; name another device of the server")
        return self.properties[name]

    def number(self, name: str, member: str) -> float:
        """Return a number of a property as it was said last."""
        return number(self.property(name).values.get(member, ""), f"{self.name}: {name}.{member}")

    def definitions(self, name: str) -> int:
        """Return how often the driver has defined a property in this connection; 0 where there is none."""
        return self.properties[name].definitions if name in self.properties else 0

    def identity(self, role: Literal["camera", "filter wheel", "laser", "lamp"], address: str) -> DeviceIdentity:
        """Return what the driver says it is."""
        info = self.properties.get("DRIVER_INFO", IndiProperty()).values
        version = info.get("DRIVER_VERSION", "")
        return DeviceIdentity(
            role=role,
            driver="indi",
            address=address,
            model=self._device,
            firmware=f"{info.get('DRIVER_EXEC', '')} {version}".strip(),
        )

    def refusal(self, what: str) -> RefusedError:
        """Return the error for an Alert, with what the driver says about it."""
        return RefusedError(f"{self.name}: refuses to {what}{self.said()}; ask for what it can do, or mend the device")

    def said(self) -> str:
        """Return what the driver said since the last request, as the end of a message."""
        return f" (the driver says: {'; '.join(self._texts)})" if self._texts else ""

    def lost(self, reason: str) -> LostError:
        """Return the error for a connection that broke, with what the driver said before."""
        return LostError(
            f"{self.name}: the connection broke ({reason}){self.said()}; check the device's cable, and that indiserver "
            "runs with its driver"
        )

    def take(self, message: IndiMessage) -> None:
        """Bring what is known up to date.

        Raises
        ------
        LostError
            The device has gone.
        """
        if message.device != self._device:
            return
        if message.attributes.get("message"):
            self._texts.append(message.attributes["message"][:LONGEST_TEXT])
        if message.tag == "delProperty":
            self._forget(message.name)
        elif message.tag == "setBLOBVector":
            self.blobs.update({blob.name: blob for blob in message.elements})
        elif message.tag.startswith(("def", "set")) and message.name:
            known = self.properties.setdefault(message.name, IndiProperty())
            is_definition = message.tag.startswith("def")
            known.definitions += is_definition
            known.settings += not is_definition
            known.state = message.attributes.get("state", known.state)
            for element in message.elements:
                known.values[element.name] = element.text
                if "min" in element.attributes and "max" in element.attributes:
                    where = f"{self.name}: range of {message.name}"
                    known.ranges[element.name] = (
                        number(element.attributes["min"], where),
                        number(element.attributes["max"], where),
                    )

    def _forget(self, name: str) -> None:
        """Drop a property, or all; without the needed one there is no device."""
        gone = [name] if name else list(self.properties)
        for each in gone:
            self.properties.pop(each, None)
        if not name or name == self._needed:
            raise self.lost(f"the driver withdrew {name or 'the device'}: it crashed, or was disconnected")
