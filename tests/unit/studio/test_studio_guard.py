import pytest

from roadsight.base.errors import InputError
from roadsight.studio.project import Project, find_project
from roadsight.studio.server import create_app, is_own_host, is_own_origin, listen

TOKEN = "right-token"
OWN = {"Host": "127.0.0.1:8711", "X-Roadsight-Token": TOKEN}


@pytest.fixture
def client(tmp_path, monkeypatch):
    (tmp_path / "config" / "sites").mkdir(parents=True)
    (tmp_path / "config" / "config.yaml").write_text("sites: []\n")
    (tmp_path / "Snakefile").touch()
    monkeypatch.chdir(tmp_path)
    return create_app(Project(tmp_path), TOKEN).test_client()


@pytest.mark.parametrize("host", ["127.0.0.1:8711", "localhost:8711", "127.0.0.1", "localhost"])
def test_loopback_is_own(host):
    assert is_own_host(host)


@pytest.mark.parametrize(
    "host",
    [
        "evil.example", "127.0.0.1.evil.example:8711", "evil@127.0.0.1", "127.0.0.1:8711/x", "",
        "[::ffff:7f00:1]", "127.1", "2130706433", "localhost.", "127.0.0.1:80:80", "[",
        "0.0.0.0:8711", "127.0.0.1:x",
    ],
)  # fmt: skip
def test_other_hosts_are_foreign(host):
    assert not is_own_host(host)


def test_origin_must_be_the_host_that_was_asked():
    assert is_own_origin("http://localhost:8711", "localhost:8711")
    for origin in ("null", "https://localhost:8711", "http://localhost:1", "http://evil.example"):
        assert not is_own_origin(origin, "localhost:8711")


def test_page_needs_no_token_but_calls_do(client):
    assert client.get("/", headers={"Host": OWN["Host"]}).status_code == 200
    assert client.get("/api/project", headers={"Host": OWN["Host"]}).status_code == 401
    wrong = OWN | {"X-Roadsight-Token": "wrong"}
    assert client.get("/api/project", headers=wrong).status_code == 401
    assert client.get("/api/project", headers=OWN | {"X-Roadsight-Token": "ä"}).status_code == 401
    assert client.get("/api/project", headers=OWN).status_code == 200


@pytest.mark.parametrize(
    "foreign",
    [
        {"Host": "evil.example:8711"}, {"Origin": "http://evil.example"}, {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"},
    ],
)  # fmt: skip
def test_other_sites_are_refused_even_with_the_token(client, foreign):
    assert client.get("/api/project", headers=OWN | foreign).status_code == 403
    assert client.put("/api/sites/x/drawing", json={}, headers=OWN | foreign).status_code == 403


def test_every_answer_forbids_what_pages_do_not_need(client):
    for path in ("/", "/api/project", "/nothing", "/assets/js/main.js"):
        headers = client.get(path, headers=OWN).headers
        assert "default-src 'self'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    "path",
    [
        "/assets/../guard.py", "/assets/%2e%2e/guard.py", "/assets/..%2fguard.py",
        "/assets//etc/passwd", "/assets/js/../../guard.py", "/api/sites/..%2f..%2fetc/cloud",
        "/api/sites/%2e%2e/cloud", "/api/sites/*/cloud", "/api/sites/x%00/cloud",
    ],
)  # fmt: skip
def test_hostile_paths_lead_nowhere(client, path):
    answer = client.get(path, headers=OWN)
    assert answer.status_code in (308, 404, 422)
    assert b"def " not in answer.data and b"root:" not in answer.data


def test_only_paths_inside_the_project_are_written(tmp_path):
    root, outside = tmp_path / "project", tmp_path / "outside"
    for folder in (root, outside):
        folder.mkdir()
    (root / "link").symlink_to(outside)
    project = Project(root)
    assert project.inside("config/sites/a.yaml") == root / "config/sites/a.yaml"
    for path in ("../outside/a", "/etc/passwd", "link/a", ".", "config/../../outside/a"):
        with pytest.raises(InputError, match="outside the project"):
            project.inside(path)


def test_results_behind_a_link_are_shown(client, tmp_path):
    outside = tmp_path.parent / f"{tmp_path.name}-scratch"
    outside.mkdir()
    (outside / "report.html").write_text("<p>the report</p>")
    (tmp_path / "results").symlink_to(outside)
    shown = client.get("/api/pages", headers=OWN).json["pages"]
    assert [page["title"] for page in shown] == ["Report"]
    assert b"the report" in client.get(shown[0]["url"], headers=OWN).data
    project = Project(tmp_path)
    assert project.named("results/a.log") == tmp_path / "results/a.log"
    for path in ("../a", "/etc/passwd", "logs/../../a"):
        with pytest.raises(InputError, match="outside the project"):
            project.named(path)


def test_the_project_is_found_from_below_and_missed_elsewhere(client, tmp_path):
    assert find_project(tmp_path / "config" / "sites") == tmp_path
    with pytest.raises(InputError, match="not inside a roadsight project"):
        find_project(tmp_path.parent)


def test_a_taken_port_is_told(client):
    first = listen(client.application, 0)
    try:
        assert first.server_address[0] == "127.0.0.1"
        with pytest.raises(InputError, match="taken"):
            listen(client.application, first.server_port)
    finally:
        first.server_close()


def test_a_broken_configuration_is_told_not_hidden(client, tmp_path):
    (tmp_path / "config" / "config.yaml").write_text("sites: [a\n")
    answer = client.get("/api/project", headers=OWN)
    assert answer.status_code == 200 and "not valid YAML" in answer.json["broken"]
    (tmp_path / "config" / "config.yaml").write_text("sites: []\n")
    (tmp_path / "config" / "sites" / "bad.yaml").write_text("site: Bad Name\nclouds: [x]\n")
    found = client.get("/api/project", headers=OWN).json["sites"]
    assert found[0]["stem"] == "bad" and "site" in found[0]["error"]
