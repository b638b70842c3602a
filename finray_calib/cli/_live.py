"""``finray live``: look through a rig in the browser while it is set up."""

import argparse
import contextlib
import threading
from pathlib import Path

from finray_calib.cli._output import give, say
from finray_calib.cli._run import ended_by_signals

LIVE_HELP = "look through a rig in the browser: focus, exposure, histogram, region"
LIVE_DESCRIPTION = """\
Open a rig and show what its camera sees in the browser of this computer: focus of a region that you draw, exposure and
saturation, histogram, and a key that switches the lamp off. Lamp and filter wheel follow the page. The laser stays off.
The address that is printed holds a token and is answered on 127.0.0.1 only: give it to nobody. Ctrl-C ends it, with the
lights off. While it runs, the rig is taken: no session can be captured on it."""
LAST_EXPOSURE_S = 10.0


def add_live(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("live", help=LIVE_HELP, description=LIVE_DESCRIPTION)
    parser.add_argument("--rig", type=Path, required=True, metavar="RIG", help="rig file (TOML)")
    parser.add_argument("--port", type=_port, default=0, metavar="N", help="port on 127.0.0.1 (default: a free one)")
    parser.set_defaults(run=run_live)


def _port(text: str) -> int:
    """Parse a port that needs no rights."""
    if not text.isdecimal() or not 1024 <= int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from 1024 to 65535")
    return int(text)


def run_live(arguments: argparse.Namespace) -> None:
    """Serve until Ctrl-C."""
    from data_schemas import RigFile
    from data_schemas.storage import read_toml
    from rigs import open_rig, rig_locked
    from rigs.live_view import LiveRig, live_server

    rig = read_toml(arguments.rig, RigFile)
    with rig_locked(rig), open_rig(rig, arguments.rig.parent) as opened:
        live = LiveRig(opened, rig)
        with live_server(live, arguments.port) as server:
            devices = threading.Thread(target=live.run, daemon=True)
            devices.start()
            try:
                with contextlib.suppress(KeyboardInterrupt), ended_by_signals():
                    say(f"{server.url}\n  open it in a browser; Ctrl-C ends the view, with the lights off")
                    give(url=server.url)
                    server.serve_forever(poll_interval=0.2)
            finally:
                live.stop()
                devices.join(LAST_EXPOSURE_S)
