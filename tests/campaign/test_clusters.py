"""The files that start a cluster elsewhere: what runs there, and who reaches the scheduler, which runs any code."""

from typing import Any

import yaml

from tests.campaign.test_runplan import ETC

DOCKER = ETC.parent / "docker"
COMPOSE: dict[str, Any] = yaml.safe_load((DOCKER / "campaign.yaml").read_text())["services"]
KUBERNETES = {
    (each["kind"], each["metadata"]["name"]): each
    for each in yaml.safe_load_all((DOCKER / "campaign-kubernetes.yaml").read_text())
}


def pod(name: str) -> dict[str, Any]:
    return KUBERNETES["Deployment", name]["spec"]["template"]["spec"]["containers"][0]


def test_both_run_the_same_programs_of_the_same_image():
    for name in ("scheduler", "worker"):
        here, there = COMPOSE[name], pod(f"delfim-{name}")
        assert here["command"][:2] == there["command"][:2] == ["dask", name]
        assert here["image"] == there["image"] == "delfim-campaign"
    assert COMPOSE["worker"]["command"][2] == "tcp://scheduler:8786"
    assert pod("delfim-worker")["command"][2] == "tcp://delfim-scheduler:8786"


def test_the_scheduler_is_reached_by_its_workers_and_from_loopback_alone():
    assert all(port.startswith("127.0.0.1:") for port in COMPOSE["scheduler"]["ports"])
    assert COMPOSE["worker"]["ports"] == []
    service = KUBERNETES["Service", "delfim-scheduler"]["spec"]
    assert "type" not in service, "inside the cluster alone"
    policy = KUBERNETES["NetworkPolicy", "delfim-scheduler"]["spec"]
    assert policy["podSelector"]["matchLabels"] == service["selector"]
    assert policy["ingress"] == [
        {"from": [{"podSelector": {"matchLabels": {"app": "delfim-worker"}}}], "ports": [{"port": 8786}]}
    ]


def test_labels_of_a_deployment_are_those_that_it_selects():
    for (kind, name), each in KUBERNETES.items():
        if kind == "Deployment":
            spec = each["spec"]
            assert spec["selector"]["matchLabels"] == spec["template"]["metadata"]["labels"] == {"app": name}
            assert spec["template"]["spec"]["containers"][0]["securityContext"]["runAsNonRoot"]
