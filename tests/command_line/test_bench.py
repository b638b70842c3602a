"""``finray bench tactile``: a simulator is taught on few presses and judged on others, whose contact it never sees."""

import hashlib
import json
import shlex
import sys
import time
from pathlib import Path

import pytest

from data_schemas import ComparisonBatch
from data_schemas.storage import read_record
from tests.command_line.running import finray
from tests.exchange.recipe_folders import write_fots

SIMULATOR = """\
import json, pathlib, sys
import cv2, numpy as np

teach, judge, renders = map(pathlib.Path, sys.argv[1:4])
kinds = {}
for press in teach.iterdir():
    told = json.loads((press / "press.json").read_text())["contact_circle"]
    contact, rest = (cv2.imread(str(press / n)).astype(float) for n in ("contact.png", "no_contact.png"))
    rows, columns = np.indices(rest.shape[:2])
    here = (np.rint(rows - told["row_px"]).astype(int), np.rint(columns - told["column_px"]).astype(int))
    ratio = (contact / rest).reshape(-1, 3)
    kinds.update({(int(r), int(c)): v for r, c, v in zip(here[0].ravel(), here[1].ravel(), ratio)})
for press in judge.iterdir():
    told = json.loads((press / "press.json").read_text())["contact_circle"]
    assert not (press / "contact.png").exists()
    rest = cv2.imread(str(press / "no_contact.png")).astype(float)
    rows, columns = np.indices(rest.shape[:2])
    ratio = np.array([
        kinds.get((int(round(r - told["row_px"])), int(round(c - told["column_px"]))), (1.0, 1.0, 1.0))
        for r, c in zip(rows.ravel(), columns.ravel())
    ]).reshape(rest.shape)
    (renders / press.name).mkdir()
    near = np.hypot(rows - told["row_px"], columns - told["column_px"])[..., None] < 1.05 * told["radius_px"]
    images = {"contact": np.where(near, rest * ratio, rest), "no_contact": rest}
    for name, image in images.items():
        cv2.imwrite(str(renders / press.name / f"{name}.png"), np.clip(np.rint(image), 0, 255).astype(np.uint8))
"""


@pytest.fixture
def captures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Five presses in closed form."""
    monkeypatch.chdir(tmp_path)
    write_fots(tmp_path / "fots")
    assert finray("import captures fots --recipe fots-gelsight --out set").status == 0
    (tmp_path / "simulator.py").write_text(SIMULATOR)
    return tmp_path / "set"


def command(tail: str = "{teach} {judge} {renders}") -> str:
    return shlex.quote(f"{sys.executable} simulator.py {tail}")


def test_a_simulator_is_judged_on_presses_that_it_has_not_seen(captures: Path) -> None:
    outcome = finray(f"bench tactile set --teach 2 --simulator shifted --command {command()} --out out")
    assert outcome.status == 0, outcome.err
    row = json.loads(Path("out/row.json").read_text())
    assert row["taught"] == ["0001", "0005"]
    assert (row["skill"]["presses"], row["skill"]["units"]) == (3, 3)
    assert row["skill"]["estimate"] > 0.9  # the same ball at other places: only the light's fall-off differs
    assert row["skill"]["low95"] < row["skill"]["estimate"] < row["skill"]["high95"] < 1.0
    assert row["blank"] == pytest.approx(0.0, abs=1e-9)
    assert row["table"]["estimate"] > 0.5
    assert row["seconds"] > 0.0
    sealed = {name: value for name, value in row.items() if name != "row_sha256"}
    assert row["row_sha256"] == hashlib.sha256(json.dumps(sealed, sort_keys=True).encode()).hexdigest()
    assert not list(Path("out/protocol/judge").rglob("contact.png"))
    assert len(list(Path("out/protocol/teach").rglob("contact.png"))) == 2
    batch = read_record(Path("out/scores/summary.json"), ComparisonBatch)
    assert {score.simulator for score in batch.simulators} == {
        "shifted", "table of the training presses", "doing nothing",
    }  # fmt: skip
    assert batch.simulators[-1].simulator == "doing nothing"
    cells = Path("out/row.csv").read_text().splitlines()[1].split(",")
    assert cells[:2] == ["set", "shifted"]
    # an untouched image is shown among no worst presses
    assert not list(Path("out/scores").glob("doing-nothing/*.html"))


def test_the_table_alone_needs_no_command(captures: Path) -> None:
    outcome = finray("bench tactile set --teach 3 --out out")
    assert outcome.status == 0, outcome.err
    row = json.loads(Path("out/row.json").read_text())
    assert (row["simulator"], row["command"], row["seconds"]) == ("table of the training presses", None, None)
    assert row["skill"] == row["table"]
    assert row["skill"]["low95"] is None  # two presses are left to judge


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("set --teach 7", "--teach 7: must be 1 to 4 for 5 presses; the simulator is judged on the presses"),
        ("set --teach 2 --simulator mine", "--simulator NAME and --command WORDS must be given together; give both"),
        ("nowhere", "nowhere: no such folder; give the folder"),
        ("set --teach 2 --simulator mine --command ''", "--command: '' cannot be split into words (no program)"),
        (
            """set --teach 2 --simulator mine --command "python 'x" """,
            '--command: "python \'x" cannot be split into words (No closing quotation)',
        ),
        (
            "set --teach 2 --simulator mine --limit-s nan --command true",
            "--limit-s nan: must be above 0 s",
        ),
        (
            "set --teach 2 --simulator mine --command 'no-such-program {judge}'",
            "--command: no-such-program cannot be run",
        ),
        (
            f"set --teach 2 --simulator mine --command '{sys.executable} -c \"raise SystemExit(3)\"'",
            "failed with exit status 3",
        ),
        (
            f"set --teach 2 --simulator mine --limit-s 0.2 --command '{sys.executable} -c \"import time; "
            "time.sleep(9)\"'",
            "--command: ran longer than 0.2 s; raise --limit-s",
        ),
        (
            f"set --teach 2 --simulator mine --command '{sys.executable} -c \"pass\"'",
            "contains no file contact",
        ),
    ],
)
def test_what_cannot_be_benched_is_told(captures: Path, options: str, message: str) -> None:
    outcome = finray(f"bench tactile {options} --out out")
    assert outcome.status == 2
    assert message in outcome.err


def test_what_a_late_simulator_has_started_ends_with_it(captures: Path) -> None:
    """A script that starts the renderer proper: only the script itself is the command's own child."""
    Path("late.sh").write_text("sleep 60 & echo $! > started; wait\n")
    outcome = finray("bench tactile set --teach 2 --simulator mine --limit-s 0.5 --command 'sh late.sh' --out out")
    assert (outcome.status, "--command: ran longer than 0.5 s" in outcome.err) == (2, True)
    state, end_s = Path(f"/proc/{int(Path('started').read_text())}/stat"), time.monotonic() + 5.0
    # one that was ended may be there still, as a zombie that nobody has asked after
    while is_running(state) and time.monotonic() < end_s:
        time.sleep(0.02)
    assert not is_running(state)


def is_running(state: Path) -> bool:
    try:
        return state.read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_a_simulator_is_scored_on_all_judged_presses_or_none(captures: Path) -> None:
    """One that leaves a hard press out, or renders one that was not asked for."""
    script = Path("simulator.py").read_text()
    Path("simulator.py").write_text(
        script.replace("for press in judge.iterdir():", "for press in sorted(judge.iterdir())[1:]:")
    )
    outcome = finray(f"bench tactile set --teach 2 --simulator lazy --command {command()} --out out")
    assert outcome.status == 2
    assert (
        "1 of 3 judged presses are missing (0002); render all of them, because the score needs every press"
        in outcome.err
    )
    Path("simulator.py").write_text(script.replace("renders / press.name", 'renders / ("x" + press.name)'))
    outcome = finray(f"bench tactile set --teach 2 --simulator other --command {command()} --out again")
    assert outcome.status == 2
    assert "contains x0002, which is not a judged press; render only the presses in" in outcome.err


def test_a_run_that_failed_starts_anew_in_the_same_folder_and_spares_what_is_not_its_own(captures: Path) -> None:
    crashes = shlex.quote(f"{sys.executable} -c 'raise SystemExit(3)'")
    assert finray(f"bench tactile set --teach 3 --simulator mine --command {crashes} --out out").status == 2
    assert Path("out/protocol/judge").is_dir()
    Path("out/mine.txt").write_text("my own note")
    outcome = finray("bench tactile set --teach 3 --out out")
    assert outcome.status == 0, outcome.err
    assert Path("out/mine.txt").read_text() == "my own note"
    assert json.loads(Path("out/asked.json").read_text())["command"] is None
    assert not Path("out/protocol").exists()
    again = finray("bench tactile set --teach 3 --out out")
    assert again.status == 2
    assert "out: exists already and is not overwritten" in again.err


def test_a_folder_of_somebody_else_is_not_touched(captures: Path) -> None:
    Path("out/scores").mkdir(parents=True)
    outcome = finray("bench tactile set --teach 3 --out out")
    assert outcome.status == 2
    assert "out: exists already and is not overwritten" in outcome.err
    assert [path.name for path in Path("out").iterdir()] == ["scores"]


def test_presses_that_are_all_one_image_cannot_be_judged(captures: Path) -> None:
    first = Path("set/0001.capture.json")
    for k in (2, 3, 4, 5):
        (Path("set") / f"000{k}.capture.json").write_bytes(first.read_bytes())
    outcome = finray("bench tactile set --teach 1 --out out")
    assert outcome.status == 2
    assert (
        "no press is left to judge the simulator on, because every contact image is also used for training; give a set"
        in outcome.err
    )


def test_our_physics_beside_the_table(captures: Path) -> None:
    run = finray("bench tactile set --elastic-gel --teach 3 --out gel")
    assert run.status == 0, run.err
    row = json.loads((captures.parent / "gel" / "row.json").read_text())
    assert row["simulator"] == "elastic gel under three lights"
    assert row["skill"]["estimate"] > 0.5
    names = [number["name"] for number in row["elastic_gel"]["numbers"]]
    assert {"thickness of the gel", "exponent of the tone curve", "direction of the red light"} <= set(names)
    assert "thickness of the gel: " in run.out
    batch = read_record(captures.parent / "gel" / "scores" / "summary.json", ComparisonBatch)
    assert {pair.simulator for pair in batch.pairs} == {
        "elastic gel under three lights", "table of the training presses", "doing nothing"
    }  # fmt: skip
    refused = finray("bench tactile set --elastic-gel --teach 2 --out two")
    assert refused.status == 2
    assert "there are only 2 training presses, but the model of an elastic gel needs at least 3" in refused.err
    for name in ("elastic gel under three lights", "doing nothing"):
        mistaken = finray(f"bench tactile set --simulator '{name}' --command 'true' --out mistaken")
        assert mistaken.status == 2
        assert "is already the name of one of finray's own rows" in mistaken.err
