"""Progress bars: on a terminal, not in a log, and never where none is asked for."""

import io
import sys

import pytest

from featherstone_gait import cli
from featherstone_gait.base.progress import progress_bar


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self):
        return True


@pytest.mark.parametrize("progress", [False, True])
@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_a_bar_is_for_terminals(stream, progress, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream())
    assert [*progress_bar(range(3), progress=progress)] == [0, 1, 2]
    assert bool(sys.stderr.getvalue()) == (progress and stream is Terminal)


@pytest.mark.parametrize("quiet", [False, True])
def test_quiet_commands_show_none_on_a_terminal_either(quiet, monkeypatch, tmp_path, capsys):
    (tmp_path / "arm.urdf").write_text('<robot name="arm"><link name="base"/></robot>', "utf-8")
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert cli.main(["check-robots", str(tmp_path), "--no-simulate", *["--quiet"] * quiet]) == 0
    assert bool(sys.stderr.getvalue()) == (not quiet)
    assert "arm.urdf" in capsys.readouterr().out
