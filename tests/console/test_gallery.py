"""The page of all runs, the page of one, and what they change."""

from __future__ import annotations

import http.client
import json
import os
import re
from pathlib import Path

import pytest

from mazebot.common.recordings.run_folder import SUMMARY, RunFolder
from mazebot.console.gallery.query import PAGE_SIZE, RunQuery
from mazebot.console.viewer_assets import assets_folder, viewer_version
from tests.console.conftest import FIRST, SECOND
from tests.console.runs import make_many, make_run, summary
from tests.console.served import Answer, Served, console, wait_until

FORM = {"Content-Type": "application/x-www-form-urlencoded"}


def names(answer: Answer) -> list[str]:
    """The runs whose cards an answer of /runs.json has, in order."""
    return [card["name"] for card in answer.json["cards"]]


def test_without_runs_the_page_says_how_to_make_one(tmp_path: Path) -> None:
    with console(tmp_path) as served:
        page = served.ask("/")
        assert page.status == 307
        assert page.headers["location"] == "/runs"
        assert "make demo" in served.ask("/runs").text


@pytest.mark.skipif(os.getuid() == 0, reason="root may read every folder")
def test_an_unreadable_folder_is_said(tmp_path: Path) -> None:
    tmp_path.chmod(0)
    with console(tmp_path) as served:
        assert "cannot be read" in served.ask("/runs").text
    tmp_path.chmod(0o700)


def test_a_folder_that_is_missing_is_said_and_seen_when_it_comes(tmp_path: Path) -> None:
    folder = tmp_path / "none"
    with console(folder) as served:
        page = served.ask("/runs")
        assert page.status == 200
        assert f"does not exist: {folder}" in page.text
        make_run(folder, FIRST)
        wait_until(lambda: names(served.ask("/runs.json")) == [FIRST], "the run")


def test_a_file_in_place_of_the_folder_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with console(tmp_path / "file") as served:
        page = served.ask("/runs")
        assert page.status == 200
        assert "cannot be read" in page.text


def test_a_card_says_what_a_run_was(shared: Served) -> None:
    page = shared.ask("/runs").text
    assert "inflation_radius = 0.4" in page
    assert "seed 3" in page
    assert "3/3 goals" in page
    assert "13 mm" in page


def test_what_a_run_lacks_is_shown_on_each_page(served: Served) -> None:
    run = make_run(served.folder, "2026-01-03_10-00-00_hole")
    counts = {"received": 835, "recorded": 509}
    (run / "summary.json").write_text(json.dumps({"messages": {"/scan": counts}, "ended": False}))
    # It may be listed before its summary is written.
    wait_until(lambda: "509 of 835 messages recorded" in served.ask("/runs").text, "the hole")
    for path in ("/runs", f"/runs/{run.name}", f"/compare?run={FIRST}&run={run.name}"):
        text = served.ask(path).text
        assert "509 of 835 messages recorded" in text
        assert "interrupted</span>" in text


def test_what_is_no_run_or_is_broken_hides_nothing(served: Served) -> None:
    (served.folder / "notes").mkdir()
    (served.folder / "file.txt").write_text("")
    broken = make_run(served.folder, "2026-01-03_10-00-00_broken")
    (broken / "summary.json").write_text("{")
    wait_until(lambda: "summary.json" in served.ask("/runs").text, "the broken run")
    for path in ("/runs", f"/runs/{broken.name}", f"/compare?run={FIRST}&run={broken.name}"):
        answer = served.ask(path)
        assert answer.status == 200
        assert "summary.json" in answer.text
    assert names(served.ask("/runs.json")) == [broken.name, SECOND, FIRST]


@pytest.mark.parametrize(
    ("query", "found"),
    [
        ("", [SECOND, FIRST]),
        ("sort=oldest", [FIRST, SECOND]),
        ("sort=error", [FIRST, SECOND]),
        ("sort=accurate", [SECOND, FIRST]),
        ("sort=nonsense", [SECOND, FIRST]),
        ("world=maze", [SECOND]),
        ("q=MAZE", [SECOND]),
        ("q=seed:3", [FIRST]),
        ("q=inflation_radius%3D0.4", [FIRST]),
        ("q=sim+10-00", [FIRST]),
        ("result=reached", [SECOND, FIRST]),
        ("result=failed", []),
        ("state=running", []),
        ("tag=none", []),
        ("page=99", [SECOND, FIRST]),
        ("page=-1", [SECOND, FIRST]),
        ("page=9999999999999", [SECOND, FIRST]),
        ("q=%00%ff", []),
    ],
)
def test_the_address_filters_and_sorts(shared: Served, query: str, found: list[str]) -> None:
    assert names(shared.ask(f"/runs.json?{query}")) == found
    page = shared.ask(f"/runs?{query}").text
    assert [name for name in (SECOND, FIRST) if f'data-run="{name}"' in page] == [
        name for name in (SECOND, FIRST) if name in found
    ]


def test_a_query_keeps_what_is_not_changed() -> None:
    query = RunQuery(text="a b", world="maze", page=3)
    assert query.address(page=4) == "?q=a+b&world=maze&page=4"
    assert RunQuery().address() == ""


def test_pages_hold_all_runs_once(tmp_path: Path) -> None:
    make_many(tmp_path, 2 * PAGE_SIZE + 5)
    with console(tmp_path) as served:
        pages = [names(served.ask(f"/runs.json?page={page}")) for page in (1, 2, 3)]
    assert [len(page) for page in pages] == [PAGE_SIZE, PAGE_SIZE, 5]
    assert len({name for page in pages for name in page}) == 2 * PAGE_SIZE + 5


def test_an_unchanged_list_is_304_and_a_changed_one_is_not(served: Served) -> None:
    first = served.ask("/runs.json")
    asked = {"If-None-Match": first.headers["etag"]}
    assert served.ask("/runs.json", headers=asked).status == 304
    make_run(served.folder, "2026-01-03_10-00-00_office")
    wait_until(lambda: served.ask("/runs.json", headers=asked).status == 200, "the change")


def test_a_run_that_is_recorded_appears_and_ends_without_a_reload(served: Served) -> None:
    path = served.folder / "2026-02-01_10-00-00_office"
    folder = RunFolder.exactly(path)

    def card() -> str:
        cards = served.ask("/runs.json").json["cards"]
        return next((str(one["html"]) for one in cards if one["name"] == path.name), "")

    wait_until(lambda: "running" in card(), "the run")
    assert served.ask(f"/runs/{path.name}").status == 200
    assert served.post(f"/runs/{path.name}/delete", {"confirm": path.name}).status == 409
    (path / "summary.json").write_text(json.dumps(summary(1)))
    wait_until(lambda: "3/3 goals" in card(), "its goals")
    folder.let_go()
    wait_until(lambda: "interrupted" in card(), "that it was killed")
    RunFolder.take_over(path).release()
    wait_until(lambda: "interrupted" not in card() and "running" not in card(), "its end")


def test_a_file_that_is_recorded_is_sent_as_it_grows(served: Served) -> None:
    folder = RunFolder.exactly(served.folder / "2026-02-01_10-00-00_sim_house")
    recording = folder.path / "run.rrd"
    recording.write_bytes(b"first ")
    address = f"/runs/{folder.path.name}/growing/run.rrd"
    assert f'data-url="{address}"' in served.ask(f"/runs/{folder.path.name}").text
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=20.0)
    connection.request("GET", address)
    answer = connection.getresponse()
    assert answer.status == 200
    assert answer.read(6) == b"first "
    with recording.open("ab") as file:
        file.write(b"second ")
    assert answer.read(7) == b"second "
    with recording.open("ab") as file:
        file.write(b"last")
    folder.release()
    assert answer.read() == b"last"
    connection.close()
    assert served.ask(address).body == b"first second last"
    page = served.ask(f"/runs/{folder.path.name}").text
    assert f'data-url="/runs/{folder.path.name}/files/run.rrd"' in page


@pytest.mark.parametrize(
    "name", ["none.rrd", ".recording", "..%2F..%2Fsecret.txt", "%2Fetc%2Fpasswd"]
)
def test_only_a_run_s_files_are_sent_as_they_grow(shared: Served, name: str) -> None:
    assert shared.ask(f"/runs/{FIRST}/growing/{name}").status == 404


@pytest.mark.parametrize("run", [FIRST, "2026-02-01_10-00-00_none"])
def test_whether_a_run_has_a_file_yet_is_no_error(shared: Served, run: str) -> None:
    answer = shared.ask(f"/runs/{run}/growing/none.rrd", method="HEAD")
    assert (answer.status, answer.body) == (204, b"")


def test_a_console_that_ends_waits_for_no_file_that_grows(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = RunFolder.exactly(tmp_path / "2026-02-01_10-00-00_sim_house")
    (folder.path / "run.rrd").write_bytes(b"first ")
    with console(tmp_path) as served:
        connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=20.0)
        connection.request("GET", f"/runs/{folder.path.name}/growing/run.rrd")
        answer = connection.getresponse()
        assert answer.read(6) == b"first "
    assert answer.read() == b""
    connection.close()
    folder.release()
    assert caplog.messages == []


def test_the_page_of_a_run_has_all_of_it(shared: Served) -> None:
    page = shared.ask(f"/runs/{FIRST}").text
    assert "location1: reached" in page
    assert f"/runs/{FIRST}/files/run.rrd" in page
    assert "localisation error, mean" in page
    assert f'href="/runs/{SECOND}"' in page
    assert "navigation.global_costmap.inflation_layer.inflation_radius" in page


def test_all_parts_of_a_recording_can_be_downloaded(served: Served) -> None:
    names = ("run.rrd", "run.mcap", "run_2.mcap", "run_10.mcap")
    for name in names[1:]:
        (served.folder / FIRST / name).write_bytes(b"x")
    page = served.ask(f"/runs/{FIRST}").text
    assert re.findall(r'class="button" href="[^"]*/files/([^"]+)" download', page) == list(names)


def test_tags_and_a_note_are_kept_and_found(served: Served) -> None:
    answer = served.post(f"/runs/{FIRST}/labels", {"tags": ["b", "a"], "note": "Slow\r\ncorner "})
    assert answer.json == {"tags": ["a", "b"], "note": "Slow\ncorner"}
    wait_until(lambda: names(served.ask("/runs.json?tag=a&q=corner")) == [FIRST], "the tag")
    form = served.ask(f"/runs/{FIRST}/labels", "POST", FORM, "tags=c&note=")
    assert form.status == 303
    assert form.headers["location"] == f"/runs/{FIRST}"
    assert 'value="c"' in served.ask(f"/runs/{FIRST}").text


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"tags": ["a/b"]}, "tag 'a/b': must be letters"),
        ({"tags": ["x" * 41]}, "40 at most"),
        # A form has words with spaces between them, a list of JSON has not.
        ({"tags": ["very slow"]}, "tag 'very slow': must be letters"),
        ({"tags": "slow"}, "tags: must be a valid list (got 'slow')"),
        ({"tags": None, "note": "x"}, "tags: must be a valid list (got None)"),
        ({"tags": ["a", 12]}, "tags.1: must be a valid string (got 12)"),
        ({"tags": {"a": 1}}, "tags: must be a valid list"),
        ({"tags": ["a"], "note": None}, "note: must be a valid string (got None)"),
        ({"note": 12}, "note: must be a valid string (got 12)"),
        ({"note": ["a", "b"]}, "note: must be a valid string"),
        ({"note": "x" * 10_001}, "note: "),
    ],
)
def test_a_tag_or_note_that_cannot_be_changes_nothing(
    served: Served, fields: dict[str, object], said: str
) -> None:
    assert served.post(f"/runs/{FIRST}/labels", {"tags": ["good"]}).status == 200
    answer = served.post(f"/runs/{FIRST}/labels", fields)
    assert answer.status == 422
    assert said in answer.json["error"]
    assert "\n" not in answer.json["error"]
    assert json.loads((served.folder / FIRST / "labels.json").read_text())["tags"] == ["good"]


@pytest.mark.parametrize(
    ("path", "fields", "allowed"),
    [
        ("labels", {"tags": ["a"], "note": "", "color": "red"}, "`tags` and `note`"),
        ("labels", {"Tags": ["a"]}, "`tags` and `note`"),
        ("delete", {"confirm": FIRST, "force": True}, "`confirm`"),
    ],
)
def test_an_unknown_field_is_named_and_changes_nothing(
    served: Served, path: str, fields: dict[str, object], allowed: str
) -> None:
    answer = served.post(f"/runs/{FIRST}/{path}", fields)
    assert answer.status == 400
    unknown = next(name for name in fields if name not in ("tags", "note", "confirm"))
    assert answer.json == {"error": f"unknown field {unknown!r}: allowed: {allowed}"}
    assert served.ask(f"/runs/{FIRST}/labels", "POST", FORM, "tags=a&color=red").status == 400
    assert not (served.folder / FIRST / "labels.json").exists()


def test_json_is_answered_with_json_and_a_form_with_a_page(served: Served) -> None:
    def post(path: str, body: str, origin: str = "") -> Answer:
        headers = {"Content-Type": "application/json", **({"Origin": origin} if origin else {})}
        return served.ask(path, "POST", headers, body)

    labels = f"/runs/{FIRST}/labels"
    answer = post(labels, '{"tags": ["a"]}')
    assert (answer.status, answer.json) == (200, {"tags": ["a"], "note": ""})
    wrong = {
        labels: ('{"tags": ["a/b"]}', 422),
        "/runs/none/labels": ("{}", 404),
        f"/runs/{FIRST}/delete": ('{"confirm": "no"}', 422),
        "/runs": ("{}", 405),
    }
    for path, (body, status) in wrong.items():
        refused = post(path, body)
        assert (refused.status, list(refused.json)) == (status, ["error"]), path
    for refused, status in (
        (post(labels, "{"), 400),
        (post(labels, "[]"), 422),
        (post(labels, '{"note": "%s"}' % ("x" * 70_000)), 413),
        (post(labels, "{}", "http://evil.example"), 403),
    ):
        assert (refused.status, list(refused.json)) == (status, ["error"])
    assert post(f"/runs/{FIRST}/delete", json.dumps({"confirm": FIRST})).json == {"deleted": FIRST}


def test_a_run_is_deleted_only_by_its_name(served: Served) -> None:
    path = f"/runs/{FIRST}/delete"
    assert "cannot be undone" in served.ask(path).text
    for confirm in ("", SECOND, "yes"):
        assert served.post(path, {"confirm": confirm}).status == 422
    assert (served.folder / FIRST).exists()
    assert served.ask(path, "POST", FORM, f"confirm={FIRST}").status == 303
    assert [folder.name for folder in served.folder.glob("2*")] == [SECOND]
    assert names(served.ask("/runs.json")) == [SECOND]
    assert served.ask(f"/runs/{FIRST}").status == 404


def test_what_a_killed_console_left_of_a_deleted_run_is_removed(tmp_path: Path) -> None:
    rest = make_run(tmp_path, f".deleted-{FIRST}")
    with console(tmp_path) as served:
        wait_until(lambda: not rest.exists(), "the rest")
        assert served.ask("/healthz").status == 200


def test_runs_are_compared_with_the_first(served: Served) -> None:
    assert "Choose two or more" in served.ask("/compare").text
    for query, title in (("", "Compare runs"), (f"run={FIRST}", "Compare 1 run")):
        assert f"<title>{title} - Mazebot</title>" in served.ask(f"/compare?{query}").text
    assert served.ask("/compare?run=none&run=" + FIRST).status == 404
    assert served.ask("/compare?" + "&".join(f"run=r{i}" for i in range(11))).status == 400
    address = f"/compare?run={FIRST}&run={SECOND}"
    page = served.ask(address).text
    assert f"{FIRST} has no digests.bin" in page
    assert str(served.folder) not in page
    assert "-0.0020" in page
    assert "better" in page
    assert "contacts" not in page
    assert "contacts" in served.ask(f"{address}&all=1").text


def test_a_file_comes_whole_in_parts_or_not_at_all(shared: Served) -> None:
    path = f"/runs/{FIRST}/files/run.rrd"
    whole = shared.ask(path)
    data = (shared.folder / FIRST / "run.rrd").read_bytes()
    assert whole.body == data
    assert whole.headers["accept-ranges"] == "bytes"
    assert whole.headers["content-type"] == "application/octet-stream"
    assert shared.ask(path, "HEAD").headers["content-length"] == str(len(data))
    for asked, part in (
        ("bytes=0-9", data[:10]),
        ("bytes=2000-", data[2000:]),
        ("bytes=-7", data[-7:]),
        ("bytes=2000-999999", data[2000:]),
    ):
        answer = shared.ask(path, headers={"Range": asked})
        assert answer.status == 206
        assert answer.body == part
        assert answer.headers["content-range"].endswith(f"/{len(data)}")
    assert shared.ask(path, headers={"Range": "bytes=999999-"}).status == 416
    for ignored in ("bytes=9-3", "lines=1-2", "bytes=0-1,4-5", "bytes=-", "bytes=x"):
        assert shared.ask(path, headers={"Range": ignored}).body == data
    etag = whole.headers["etag"]
    unchanged = shared.ask(path, headers={"If-None-Match": f'"x", {etag}'})
    assert unchanged.status == 304
    assert unchanged.body == b""
    since = {"If-Modified-Since": whole.headers["last-modified"]}
    assert shared.ask(path, headers=since).status == 304
    assert shared.ask(path, headers={"If-Modified-Since": "x"}).status == 200
    other = {"Range": "bytes=0-9", "If-Range": '"other"'}
    assert shared.ask(path, headers=other).body == data
    assert shared.ask(path, headers={**other, "If-Range": etag}).body == data[:10]


def test_the_viewer_is_that_of_the_recorder_s_version(shared: Served) -> None:
    version = viewer_version()
    assert version
    assert f'data-version="{version}"' in shared.ask(f"/runs/{FIRST}").text
    module = shared.ask(f"/viewer/{version}/re_viewer_bg.wasm", "HEAD")
    assert module.headers["content-type"] == "application/wasm"
    assert "immutable" in module.headers["cache-control"]
    script = shared.ask(f"/viewer/{version}/widget.js")
    assert script.headers["content-type"].startswith("text/javascript")
    assert b"open_url" in script.body


def test_a_packed_viewer_is_sent_as_it_is(
    tmp_path: Path, shared: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "widget.js.gz").write_bytes(b"packed")
    monkeypatch.setattr("mazebot.console.viewer_assets.assets_folder", lambda: tmp_path)
    assert assets_folder() is not None
    answer = shared.ask(f"/viewer/{viewer_version()}/widget.js")
    assert answer.headers["content-encoding"] == "gzip"
    assert answer.body == b"packed"


def processor_s() -> float:
    """Processor time of this process, which is the server's too."""
    times = os.times()
    return times.user + times.system


@pytest.mark.slow
def test_the_first_page_of_two_thousand_runs_comes_at_once(tmp_path: Path) -> None:
    few, many = tmp_path / "few", tmp_path / "many"
    make_many(few, PAGE_SIZE)
    make_many(many, 2000)
    summaries = [run / SUMMARY for run in many.iterdir()]
    for file in summaries:
        # A file that was just written may yet be changed within the clock's resolution.
        os.utime(file, (1e9, 1e9))
    with console(few) as of_few, console(many) as of_many:
        assert len(names(of_few.ask("/runs.json"))) == len(names(of_many.ask("/runs.json")))
        spent_s = []
        # In turns: the pace of a machine that others use may be another one a minute later.
        for served in (of_few, of_many) * 3:
            start_s = processor_s()
            for _ in range(10):
                assert served.ask("/runs").status == 200
            spent_s.append(processor_s() - start_s)
    assert min(spent_s[1::2]) < 4.0 * min(spent_s[::2])
    # After a start, what was read before is not read again: files that became unreadable since,
    # though of the same version, are not noticed.
    for file in summaries:
        size = file.stat().st_size
        with file.open("r+b") as spoilt:
            spoilt.write(b"x" * size)
        os.utime(file, (1e9, 1e9))
    with console(many) as served:
        page = served.ask("/runs").text
    assert page.count('class="card"') == PAGE_SIZE
    assert 'class="warn"' not in page
