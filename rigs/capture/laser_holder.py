"""A program that keeps the laser on behind its guard until it is killed: the victim of an acceptance check.

Started as ``python -m rigs.capture.laser_holder DRIVER ADDRESS``; says ``ON`` and the process numbers of guard and
watch. It ends, and the laser goes off, when its standard input closes (whoever started it is gone), at the latest after
10 s.
"""

import select
import sys
from typing import Final

from data_schemas.errors import FinrayError
from rigs.light_guard import GuardedLight

LONGEST_S: Final = 10.0


def main(arguments: list[str]) -> int:
    """Hold the laser that the arguments name."""
    driver, address = arguments
    try:
        light = GuardedLight("laser", driver, address)
        try:
            light.open()
            with light.lit():
                sys.stdout.write(f"ON {light.guard_pid} {light.watch_pid}\n")
                sys.stdout.flush()
                select.select([sys.stdin], [], [], LONGEST_S)
        finally:
            light.close()
    except FinrayError as error:
        sys.stdout.write(f"{' '.join(str(error).split())}\n")
        sys.stdout.flush()
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
