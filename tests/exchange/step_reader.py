"""A small reader of STEP files for tests, written from the standard's text and not from the writer."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

ENTITY = re.compile(r"^#(\d+)=(.*);$", re.MULTILINE)
TOKEN = re.compile(r"#\d+|'(?:[^']|'')*'|\.[A-Z_]+\.|[A-Z_][A-Z_0-9]*|[-+]?\d+\.?\d*(?:E[-+]?\d+)?|[(),$*]")


@dataclass(frozen=True)
class Entity:
    kind: str
    values: tuple[Any, ...]


class StepFile:
    """Entities by number; a reference is ("#", number). Of an entity of several kinds, the named parts by kind."""

    def __init__(self, content: bytes) -> None:
        text = content.decode("ascii")
        assert text.startswith("ISO-10303-21;\nHEADER;\n")
        assert text.endswith("ENDSEC;\nEND-ISO-10303-21;\n")
        self.header, data = text.split("DATA;\n")
        self.entities: dict[int, Entity | dict[str, tuple[Any, ...]]] = {}
        for number, line in ENTITY.findall(data):
            tokens = TOKEN.findall(line)
            assert "".join(tokens).replace(" ", "") == line.replace(" ", "")
            self.entities[int(number)] = _entity(tokens)

    def all(self, kind: str) -> list[Entity]:
        return [e for e in self.entities.values() if isinstance(e, Entity) and e.kind == kind]

    def at(self, reference: tuple[str, int]) -> Any:
        return self.entities[reference[1]]

    def point(self, reference: tuple[str, int]) -> np.ndarray:
        entity = self.at(reference)
        if entity.kind == "VERTEX_POINT":
            return self.point(entity.values[1])
        assert entity.kind in ("CARTESIAN_POINT", "DIRECTION")
        return np.array(entity.values[1])

    def placement(self, reference: tuple[str, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return place, z axis and x axis."""
        _, place, axis, across = self.at(reference).values
        return self.point(place), self.point(axis), self.point(across)

    def references(self) -> set[int]:
        found: set[int] = set()

        def look(value: Any) -> None:
            if isinstance(value, tuple) and len(value) == 2 and value[0] == "#":
                found.add(value[1])
            elif isinstance(value, tuple):
                for one in value:
                    look(one)

        for entity in self.entities.values():
            for values in [entity.values] if isinstance(entity, Entity) else entity.values():
                look(values)
        return found

    def faces(self) -> list[tuple[Entity, bool, list[tuple[str, list[tuple[int, bool]]]]]]:
        """Return surface, whether its normal points outward, and the loops of (edge number, forward) of each face."""
        found = []
        for face in self.all("ADVANCED_FACE"):
            loops = []
            for reference in face.values[1]:
                bound = self.at(reference)
                assert bound.values[2] == ".T."
                runs = [self.at(run).values for run in self.at(bound.values[1]).values[1]]
                loops.append((bound.kind, [(run[3][1], run[4] == ".T.") for run in runs]))
            found.append((self.at(face.values[2]), face.values[3] == ".T.", loops))
        return found

    def polygon(self, loop: list[tuple[int, bool]]) -> np.ndarray:
        """Return the corners of a loop, checking that each edge begins where the last one ended."""
        ends = []
        for edge, forward in loop:
            _, start, end, *_ = self.entities[edge].values  # type: ignore[union-attr]
            ends.append((start, end) if forward else (end, start))
        for (_, end), (start, _) in zip(ends, ends[1:] + ends[:1], strict=True):
            assert end == start
        return np.array([self.point(start) for start, _ in ends])


def _entity(tokens: list[str]) -> Entity | dict[str, tuple[Any, ...]]:
    if tokens[0] != "(":
        values, at = _values(tokens, 1)
        assert at == len(tokens)
        return Entity(tokens[0], values)
    at, parts = 1, {}
    while tokens[at] != ")":
        kind = tokens[at]
        parts[kind], at = _values(tokens, at + 1)
    return parts


def _values(tokens: list[str], at: int) -> tuple[tuple[Any, ...], int]:
    assert tokens[at] == "("
    values: list[Any] = []
    at += 1
    while tokens[at] != ")":
        token = tokens[at]
        if token == "(":
            value, at = _values(tokens, at)
            values.append(value)
            continue
        if token == ",":
            pass
        elif token[0] == "#":
            values.append(("#", int(token[1:])))
        elif token[0] in "+-0123456789":
            values.append(float(token))
        elif tokens[at + 1] == "(":
            inner, at = _values(tokens, at + 1)
            values.append(Entity(token, inner))
            continue
        else:
            values.append(token)
        at += 1
    return tuple(values), at + 1
