"""A light that never stays on: three processes watch each other while it is lit, and fewer than three mean dark.

The owner is the program that captures; ``with light.lit():`` switches off however the block is left. The guard is a
process that alone holds the light's connection. The watch is a third one with a line of its own to the light. Each
sees within hundredths of a second that another is killed or stopped, and switches off. None of them covers a computer
that hangs or loses its cable: then only a layer outside of it helps, such as a dead-man in the light's controller.
"""

from rigs.light_guard.guarded_light import GuardedLight, guarded_light
from rigs.light_guard.outside_layer import off_lines, require_outside_layer

__all__ = ["GuardedLight", "guarded_light", "off_lines", "require_outside_layer"]
