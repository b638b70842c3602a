import subprocess
import sys

import pytest

from data_schemas import MissingExtraError, SimulateError
from finray_calib.cli._run import open_engine
from finray_calib.demo._machine_checks import check_renderer
from sim.optics import _renderer as variants


def test_importing_the_optics_does_not_import_the_renderer():
    code = (
        "import sys, sim, sim.optics._render, sim.optics._angle_sweep, sim.optics._scene\n"
        "raise SystemExit('mitsuba' in sys.modules or 'drjit' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_scalar_needs_no_llvm():
    choice = variants.choose_variant("scalar", libraries=[])
    assert (choice.variant, choice.llvm_library) == ("scalar_rgb", None)


def test_without_llvm_falls_back_and_says_how_to_install_it():
    choice = variants.choose_variant("auto", libraries=[])
    assert choice.variant == "scalar_rgb"
    assert "apt-get install libllvm19" in choice.note


def test_the_user_is_told_of_a_second_choice_and_of_no_other(monkeypatch, capsys):
    monkeypatch.setattr(variants, "find_llvm_libraries", lambda: [])
    assert open_engine("auto").variant() == "scalar_rgb"
    told = capsys.readouterr().err
    assert told.startswith("scalar_rgb renders: no LLVM library of version >= 17 was found; install LLVM 17 or newer")
    assert told.count("\n") == 1
    open_engine("scalar")
    assert capsys.readouterr().err == ""


def test_the_proof_refuses_a_bogus_library(tmp_path):
    bogus = tmp_path / "libLLVM-19.so"
    bogus.write_bytes(b"not a library")
    choice = variants.choose_variant("auto", libraries=[str(bogus)])
    assert choice.variant == "scalar_rgb"
    assert "libLLVM-19.so: the test picture failed (ImportError: " in choice.note
    with pytest.raises(
        MissingExtraError, match=r"with LLVM was requested, but .*libLLVM-19\.so: the test picture failed"
    ):
        variants.choose_variant("llvm", libraries=[str(bogus)])


def import_without_libatomic(name):
    """Fail as Dr.Jit does on a system without the library: with an error of its own while it looks at the first."""
    try:
        raise ImportError("libatomic.so.1: cannot open shared object file: No such file or directory")
    except ImportError:
        raise NameError(f"name '_drjit_ext' of {name} is not defined")  # noqa: B904 - as its own code does


def test_a_library_that_the_system_lacks_is_named_with_its_package(monkeypatch):
    monkeypatch.setattr(variants.importlib, "import_module", import_without_libatomic)
    with pytest.raises(SimulateError) as failed:
        variants.render_proof_picture("scalar_rgb")
    failure = f"the test picture {failed.value}"
    assert failure == "the test picture needs a library that this system lacks: libatomic.so.1"
    monkeypatch.setattr(variants, "prove_variant", lambda variant: failure)
    with pytest.raises(MissingExtraError, match=r"libatomic\.so\.1 is missing .* \(sudo apt-get install libatomic1\)"):
        variants.choose_variant("scalar")


def test_the_doctor_says_what_to_install(monkeypatch):
    monkeypatch.setattr(variants, "prove_variant", lambda variant: f"the test picture {variants.ABSENT}libatomic.so.1")
    found = check_renderer()
    assert (found["state"], found["mend"]) == ("bad", "sudo apt-get install libatomic1")
    assert "lacks: libatomic.so.1" in found["found"]


def test_a_proof_that_hangs_is_refused(monkeypatch):
    monkeypatch.setattr(variants, "_PROOF_TIMEOUT_S", 0.0)
    assert "longer than" in str(variants.prove_llvm_library("/nonexistent/libLLVM-hanging.so"))


def test_libraries_are_tried_from_the_newest_and_old_ones_never(tmp_path, monkeypatch):
    for name in ("libLLVM-14.so.1", "libLLVM-16.so.1", "libLLVM.so.19.1", "libLLVM.so.22.1", "libLLVM-17.so.1"):
        (tmp_path / name).touch()
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(variants, "_LIBRARY_PATTERNS", ((tmp_path, "libLLVM*"),))
    names = [path.rsplit("/", 1)[1] for path in variants.find_llvm_libraries()]
    assert names == ["libLLVM.so.22.1", "libLLVM.so.19.1", "libLLVM-17.so.1"]
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/preset/libLLVM.so")
    assert variants.find_llvm_libraries() == ["/preset/libLLVM.so"]


@pytest.mark.renderer
def test_a_proven_library_is_opened(llvm_choice):
    assert llvm_choice.variant == "llvm_ad_rgb"
    assert variants.open_renderer(llvm_choice, threads=1).variant() == "llvm_ad_rgb"
    assert variants.open_renderer(variants.choose_variant("scalar")).variant() == "scalar_rgb"
