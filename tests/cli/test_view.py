"""`warpqem view`: the page of a server that only this machine and only who knows the address can reach."""

from __future__ import annotations

import http.client
import json
import subprocess
import sys
import threading
from urllib.parse import urlsplit

import numpy as np
import pytest
from typer.testing import CliRunner

import warpqem
from tests.support.report import data_of, decode, waving
from tests.support.usd_stages import cloth_stage
from warpqem.cli.main import app
from warpqem.errors import StageError
from warpqem.progressive import save
from warpqem.report.live import LiveLevels
from warpqem.report.server import PageServer
from warpqem.usd import SimplifyOptions, simplify_stage
from warpqem.usd.commands.report_page import stage_report


@pytest.fixture(scope="module")
def progressive():
    points, faces = waving()
    return warpqem.build_progressive(points, faces, device="cpu")


@pytest.fixture
def served():
    """A server with a page and three levels, and its address."""

    def level(index: int) -> dict[str, int]:
        if index > 2:
            raise IndexError(index)
        return {"index": index}

    server = PageServer("<p>page</p>", level)
    thread = threading.Thread(target=server.serve)
    thread.start()
    yield urlsplit(server.address)
    server.stop()
    thread.join()


def ask(address, path: str, host: str | None = None) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(address.hostname, address.port, timeout=10)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content


def test_page_and_levels_are_at_the_address(served):
    assert ask(served, served.path) == (200, b"<p>page</p>")
    assert ask(served, f"{served.path}level/2") == (200, b'{"index": 2}')


@pytest.mark.parametrize("path", ["level/3", "level/-1", "level/x", "level/1/", "../", "favicon.ico"])
def test_there_is_nothing_else(served, path):
    assert ask(served, served.path + path)[0] == 404


@pytest.mark.parametrize("path", ["/", "/level/1", "/wrong-token/"])
def test_nothing_is_found_without_the_token(served, path):
    assert ask(served, path)[0] == 404


def test_other_host_names_are_refused(served):
    assert ask(served, served.path, host=f"evil.example:{served.port}")[0] == 404


def test_only_this_machine_is_listened_to(served):
    assert served.hostname == "127.0.0.1"


def test_tokens_differ():
    servers = [PageServer("") for _ in range(2)]
    assert len({urlsplit(server.address).path for server in servers}) == 2
    for server in servers:
        server._server.server_close()


def test_port_that_is_taken_is_named(served):
    with pytest.raises(StageError, match=f"port {served.port}: cannot be used"):
        PageServer("", port=served.port)


def test_live_levels_are_those_of_the_progressive_mesh(progressive):
    live = LiveLevels(progressive, "waves", {}, device="cpu")
    data = live.data()
    faces = [level["faces"] for level in data["levels"]]
    assert faces == sorted(faces, reverse=True)
    assert (faces[0], faces[-1]) == (progressive.face_count, progressive.base_face_count)
    index = len(faces) // 2
    mesh = live.level(index)["mesh"]
    expected = progressive.level(live.splits[index])
    shape = (faces[index], 3)
    np.testing.assert_array_equal(decode(mesh["faces"], np.uint32, shape), expected.faces)
    assert data["curve"]["error"][index] == expected.error


def test_level_that_is_not_there_is_none(progressive):
    with pytest.raises(IndexError):
        LiveLevels(progressive, "waves", {}, device="cpu").level(1000)


def test_two_files_are_shown_beside_each_other(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(ratio=0.5, device="cpu"))
    report = stage_report(str(tmp_path / "in.usda"), str(tmp_path / "out.usda"))
    assert (len(report.faces), [(level.name, len(level.faces)) for level in report.levels]) == (128, [("out.usda", 64)])


@pytest.mark.parametrize("beside", [False, True])
def test_levels_of_a_file_are_found(tmp_path, beside):
    cloth_stage(tmp_path / "in.usda")
    simplify_stage(tmp_path / "in.usda", tmp_path / "out.usda", SimplifyOptions(lods=(0.5, 0.25), device="cpu"))
    files = (tmp_path / "in.usda", tmp_path / "out.usda") if beside else (tmp_path / "out.usda",)
    report = stage_report(*map(str, files))
    assert len(report.faces) == 128
    assert [(level.name, len(level.faces)) for level in report.levels] == [("LOD1", 64), ("LOD2", 32)]


def test_file_alone_is_shown_without_levels(tmp_path):
    cloth_stage(tmp_path / "in.usda")
    assert stage_report(str(tmp_path / "in.usda")).levels == []


def test_command_serves_until_interrupted(progressive, tmp_path):
    save(progressive, tmp_path / "mesh.wpqm")
    command = [sys.executable, "-m", "warpqem", "view", str(tmp_path / "mesh.wpqm"), "--no-browser", "--device", "cpu"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        address = urlsplit(process.stdout.readline().strip())
        status, page = ask(address, address.path)
        assert (status, data_of(page.decode())["title"]) == (200, "mesh.wpqm")
        assert "heat" in json.loads(ask(address, f"{address.path}level/0")[1])["mesh"]
        process.send_signal(2)
        assert process.wait(timeout=20) == 0


@pytest.mark.parametrize("others", [["out.usda"], ["--prim", "/A"], ["--frames", "1:2"]])
def test_progressive_mesh_is_shown_alone_and_whole(others):
    done = CliRunner().invoke(app, ["view", "mesh.wpqm", *others])
    assert done.exit_code == 2
