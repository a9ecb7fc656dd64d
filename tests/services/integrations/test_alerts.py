"""The alerts for Prometheus in deploy/, as promtool of Prometheus itself judges them."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from libmodbus_py.services.integrations.metrics import FAMILIES
from tests.support.cases import each_case

RULES = Path(__file__).parents[3] / "deploy" / "alerts.yml"
TESTS = Path(__file__).with_name("alerts_test.yml")


@pytest.mark.skipif(shutil.which("promtool") is None, reason="Prometheus is not installed")
@each_case("arguments", [("check", "rules", "--lint-fatal", RULES), ("test", "rules", TESTS)])
def test_promtool_accepts_the_rules_and_their_results(arguments: tuple[str | Path, ...]) -> None:
    result = subprocess.run(["promtool", *arguments], capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stdout + result.stderr


def test_rules_and_their_tests_use_metrics_that_exist() -> None:
    names = {family.name + ("_total" if family.type == "counter" else "") for family in FAMILIES}
    metrics = set(re.findall(r"\bmodbus_\w+", RULES.read_text() + TESTS.read_text()))
    assert metrics - names == set()


def test_each_alert_is_tested() -> None:
    alerts = re.findall(r"alert: (\w+)", RULES.read_text())
    assert len(alerts) > 5
    assert set(alerts) == set(re.findall(r"alertname: (\w+)", TESTS.read_text()))
