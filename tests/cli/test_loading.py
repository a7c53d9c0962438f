"""Loading without Python's search for garbage."""

import gc
import subprocess
import sys

import pytest

from warpqem.cli import loading


@pytest.mark.parametrize("searched", [True, False])
def test_garbage_is_not_searched_for_while_a_command_loads_and_as_before_afterwards(searched, monkeypatch):
    monkeypatch.setattr(gc, "freeze", lambda: pytest.fail("the objects of others may become garbage"))
    before = gc.isenabled()
    try:
        (gc.enable if searched else gc.disable)()
        with loading.loading(usd=False):
            assert not gc.isenabled()
        assert gc.isenabled() is searched
    finally:
        (gc.enable if before else gc.disable)()


def test_what_a_command_has_loaded_in_a_process_of_its_own_is_never_searched():
    code = (
        "import gc; from warpqem.cli import loading as l; l.own_process()\n"
        "with l.loading(): import warpqem.measure\n"
        "assert gc.isenabled() and gc.get_freeze_count() > 100_000, gc.get_freeze_count()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
