"""What is in deploy/ is what its readers take: Prometheus, Grafana, Kubernetes, dpkg."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tarfile

import kubernetes_validate
import pytest
import yaml

from support.prometheus import tool
from support.server import REPO, binary

DEPLOY = REPO / "deploy"
MONITORING = DEPLOY / "monitoring"
MANIFESTS = [
    pytest.param(document, id=f"{document['kind']} {document['metadata']['name']}")
    for file in sorted((DEPLOY / "kubernetes").glob("*.yaml"))
    for document in yaml.safe_load_all(file.read_text())
]


def promtool(*arguments):
    program = tool("promtool")
    if program is None:
        pytest.skip("no promtool: install prometheus, or name its folder in PROMETHEUS_DIR")
    done = subprocess.run([program, *arguments], cwd=MONITORING, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_alerts_are_rules_that_prometheus_takes():
    promtool("check", "rules", "alerts.yml")


def test_alerts_come_when_they_should_and_not_else():
    promtool("test", "rules", "alerts.test.yml")


def test_every_alert_is_tried():
    rules = yaml.safe_load((MONITORING / "alerts.yml").read_text())["groups"][0]["rules"]
    tried = {
        expected["alertname"]
        for test in yaml.safe_load((MONITORING / "alerts.test.yml").read_text())["tests"]
        for expected in test["alert_rule_test"]
        if expected.get("exp_alerts")
    }
    assert tried == {rule["alert"] for rule in rules}


def test_prometheus_takes_its_configuration():
    promtool("check", "config", "prometheus.yml")


def test_the_dashboard_is_the_one_that_its_script_writes():
    subprocess.run([MONITORING / "make-dashboard", "--check"], check=True)


def test_the_dashboard_has_what_grafana_asks_of_one():
    dashboard = json.loads((MONITORING / "grafana" / "dashboard.json").read_text())
    assert isinstance(dashboard["schemaVersion"], int)
    assert dashboard["title"] and dashboard["uid"]
    variables = {variable["name"] for variable in dashboard["templating"]["list"]}
    taken, numbers = set(), set()
    for panel in dashboard["panels"]:
        numbers.add(panel["id"])
        assert panel["type"] in {"row", "stat", "timeseries", "table"}
        place = panel["gridPos"]
        assert place["x"] >= 0 and place["x"] + place["w"] <= 24
        cells = {(place["x"] + x, place["y"] + y) for x in range(place["w"]) for y in range(place["h"])}
        assert not cells & taken, f"{panel['title']} lies over another panel"
        taken |= cells
        if panel["type"] == "row":
            continue
        assert panel["datasource"] == {"type": "prometheus", "uid": "${source}"}
        assert len({target["refId"] for target in panel["targets"]}) == len(panel["targets"])
        assert all("$instance" in target["expr"] for target in panel["targets"])
    assert len(numbers) == len(dashboard["panels"])
    assert variables == {"source", "instance"}


@pytest.mark.parametrize("manifest", MANIFESTS)
def test_manifests_are_what_kubernetes_takes(manifest):
    kubernetes_validate.validate(manifest, "1.30", strict=True)


def test_the_pod_can_neither_become_root_nor_write_but_to_its_data():
    pod = next(m.values[0] for m in MANIFESTS if m.values[0]["kind"] == "StatefulSet")["spec"]["template"]["spec"]
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["automountServiceAccountToken"] is False
    (container,) = pod["containers"]
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
        assert container[probe]["httpGet"]["port"] == "telemetry"


def test_the_service_answers_to_its_names_in_the_cluster():
    by_kind = {m.values[0]["kind"]: m.values[0] for m in MANIFESTS if m.values[0]["metadata"]["name"] == "percept"}
    (container,) = by_kind["StatefulSet"]["spec"]["template"]["spec"]["containers"]
    settings = {variable["name"]: variable["value"] for variable in container["env"]}
    service = by_kind["Service"]["metadata"]["name"]
    assert service in json.loads(settings["PERCEPT_LISTEN_ALLOWED_HOSTS"])


def test_compose_watches_the_address_that_percept_tells_at():
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    port = compose["services"]["percept"]["environment"]["PERCEPT_TELEMETRY_LISTEN"].rsplit(":", 1)[1]
    scraped = yaml.safe_load((MONITORING / "prometheus.yml").read_text())["scrape_configs"][0]["static_configs"]
    assert scraped == [{"targets": [f"percept:{port}"]}]
    for service in compose["services"].values():
        for published in service.get("ports", []):
            assert published.startswith("127.0.0.1:"), f"{published} is open to the network"
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            assert (DEPLOY / source).exists() if source.startswith(".") else source in compose["volumes"]


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    """The folder of an archive and a package, which take a while to be pressed."""
    out = tmp_path_factory.mktemp("packages")
    subprocess.run([DEPLOY / "package", "--binary", binary(), "--out", out], check=True, capture_output=True)
    return out


def test_packages_hold_a_program_that_runs(packages, tmp_path):
    (archive,) = packages.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        tar.extractall(tmp_path / "tar", filter="data")
    (program,) = (tmp_path / "tar").glob("*/bin/percept")
    assert subprocess.run([program, "--version"], capture_output=True, text=True, check=True).stdout.startswith(
        "percept "
    )
    if shutil.which("dpkg-deb") is None:
        pytest.skip("no dpkg-deb")
    (package,) = packages.glob("*.deb")
    subprocess.run(["dpkg-deb", "--extract", package, tmp_path / "deb"], check=True)
    unit = (tmp_path / "deb/lib/systemd/system/percept.service").read_text()
    assert "ExecStart=/usr/bin/percept serve" in unit
    assert "\nEnvironment=PERCEPT_CONFIG=/etc/percept/percept.toml" in unit
    config = tmp_path / "deb/etc/percept/percept.toml"
    checked = subprocess.run(
        [tmp_path / "deb/usr/bin/percept", "config", "--check", config], capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stderr


def test_the_unit_is_one_that_systemd_takes(tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze")
    unit = tmp_path / "percept.service"
    unit.write_text((DEPLOY / "percept.service").read_text().replace("/usr/local/bin/percept", str(binary())))
    found = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True)
    assert (found.returncode, found.stderr) == (0, "")


def test_an_upgrade_keeps_the_settings_and_a_purge_leaves_none(packages, tmp_path):
    if shutil.which("dpkg") is None or os.geteuid() != 0:
        pytest.skip("no dpkg, or not root")
    root = tmp_path / "root"
    (root / "var/lib/dpkg").mkdir(parents=True)
    (root / "var/lib/dpkg/status").touch()
    (package,) = packages.glob("*.deb")

    def dpkg(*arguments):
        # What it depends on is not in this root, nor a shell.
        forced = ["dpkg", f"--root={root}", "--force-script-chrootless", "--force-depends"]
        done = subprocess.run([*forced, *arguments], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    config = root / "etc/percept/percept.toml"
    dpkg("--install", package)
    config.write_text(config.read_text() + "# mine\n")
    dpkg("--install", package)
    assert config.read_text().endswith("# mine\n")
    dpkg("--purge", "percept")
    assert not config.exists()
    assert not (root / "usr/bin/percept").exists()


def test_the_script_that_tries_upgrades_sees_nothing_lost_between_a_program_and_itself():
    done = subprocess.run([DEPLOY / "try-upgrade", binary(), binary()], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "forward again: all of it is there" in done.stdout
