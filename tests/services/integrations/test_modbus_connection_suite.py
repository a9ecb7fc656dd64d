"""
modbus-connection's own tests, with our backend in the place of tmodbus's.

./run test fetches their sdist, which has them, and pytest-asyncio, which they need and ours must
not load. All of them run, those of pymodbus's backend included; it takes ten seconds. Those about
SunSpec would clone the definitions of models, and get those of pysunspec2.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip("modbus_connection", reason="modbus-connection's tests need Python 3.12")

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

# See ./run.
FETCHED = Path(sys.prefix, "modbus_connection")

FAKE = "puts a fake client of tmodbus into the place of a real one"
INSIDE = "looks into tmodbus's client"
BUSY = "wants tmodbus's way with busy devices, which it asks again; pymodbus and ours do not"
RTU_OVER_UDP = "wants it refused, as tmodbus does; ours has it"
NAME = "tells the backends apart by the names of their modules"

NOT_OURS: dict[str, str] = {
    f"tests.{test}": reason
    for reason, tests in {
        FAKE: [
            "test_connect_errors::test_tmodbus_close_maps_backend_error",
            "test_connect_errors::test_tmodbus_connect_maps_raising_connect",
            "test_connect_errors::test_tmodbus_connect_timeout_maps_to_timeout_error",
            "test_tmodbus::test_a_serial_framing_over_tcp_keeps_the_smallest_inter_frame_gap",
            "test_tmodbus::test_close_suppresses_on_connection_lost_hook",
            "test_tmodbus::test_desync_survives_a_failing_disconnect",
            "test_tmodbus::test_exception_response_maps_to_the_typed_subclass",
            "test_tmodbus::test_invalid_response_maps_to_protocol_error",
            "test_tmodbus::test_mismatched_replies_raise_desync[function-code]",
            "test_tmodbus::test_mismatched_replies_raise_desync[header-mismatch]",
            "test_tmodbus::test_read_file_record_decodes_to_words",
            "test_tmodbus::test_request_failure_maps_but_does_not_fire_on_connection_lost",
            "test_tmodbus::test_scoped_host_reaches_client[ascii-over-socket]",
            "test_tmodbus::test_scoped_host_reaches_client[rtu-over-socket]",
            "test_tmodbus::test_scoped_host_reaches_client[tcp]",
            "test_tmodbus::test_transport_hook_clears_the_client_and_unit_cache",
            "test_tmodbus::test_transport_hook_fires_registered_callbacks",
            "test_tmodbus::test_write_file_record_encodes_words_to_payload",
        ],
        INSIDE: [
            "test_backend_retry_policy::test_tmodbus_transport_propagates_response_without_retry",
            "test_serial::test_serial_reads[ascii-tmodbus]",
            "test_serial::test_serial_reads[rtu-tmodbus]",
        ],
        BUSY: [
            "test_backend_retry_policy::test_tmodbus_busy_retransmission_is_bounded",
            "test_backend_retry_policy::"
            "test_tmodbus_retransmits_a_busy_response_until_the_device_answers",
        ],
        RTU_OVER_UDP: [
            "test_cli_helper::test_load_backend_reports_pymodbus_requirement",
            "test_cli_helper::test_load_backend_routes_unsupported_tmodbus_requests",
            "test_cli_helper::test_the_backends_state_their_framings",
            "test_factories::test_tmodbus_connect_udp_rejects_non_socket_framing",
            "test_framer_guard::test_tmodbus_rejects_non_socket_udp_framing[rtu]",
            "test_udp::test_tmodbus_udp_non_socket_framing_rejected[rtu]",
        ],
        NAME: ["test_cli_helper::test_connect_from_args_dispatches_by_transport"],
    }.items()
    for test in tests
}
"""Test -> why it says nothing about ours."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Their tests, and their settings of pytest."""
    name = f"modbus_connection-{version('modbus-connection')}"
    sdist = FETCHED / f"{name}.tar.gz"
    if not sdist.exists():
        pytest.skip(f"no {sdist.name} in {FETCHED}: ./run test fetches it, if it can")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    theirs = tmp_path / name
    (theirs / "src").rename(theirs / "not-src")  # what is installed is tried
    return theirs


def models(folder: Path) -> Path:
    """Return a Git repository with the definitions of SunSpec's models, as theirs has them."""
    spec = find_spec("sunspec2")
    assert spec is not None
    assert spec.origin is not None
    repository = folder / "sunspec-models"
    shutil.copytree(Path(spec.origin).parent / "models" / "json", repository / "json")
    author = ["-c", "user.name=tests", "-c", "user.email=tests@example.org"]
    for words in (["init", "-q"], ["add", "."], [*author, "commit", "-q", "-m", "Models"]):
        subprocess.run(["git", *words], cwd=repository, check=True)
    return repository


def outcomes(folder: Path) -> dict[str, str]:
    """Run them; test -> "passed", "skipped", "failure" or "error"."""
    report = folder / "report.xml"
    paths = [str(HERE), str(ROOT), str(FETCHED / "plugins")]
    options = ["-p", "no:cacheprovider", "-p", "no:libmodbus_py", "-p", "in_place_of_tmodbus"]
    options += ["-o", "asyncio_default_fixture_loop_scope=function", f"--junitxml={report}"]
    # What this run of pytest has set is its own; and nothing is fetched, what they clone is here.
    surroundings = {name: os.environ[name] for name in os.environ if not name.startswith("PYTEST")}
    surroundings |= {
        "PYTHONPATH": os.pathsep.join(paths),
        "GIT_ALLOW_PROTOCOL": "file",
        "GIT_CONFIG_COUNT": "1",
        "GIT_CONFIG_KEY_0": f"url.{models(folder).as_uri()}.insteadOf",
        "GIT_CONFIG_VALUE_0": "https://github.com/sunspec/models",
    }
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *options, "tests"],
        cwd=folder,
        env=surroundings,
        capture_output=True,
        text=True,
        timeout=270,
        check=False,
    )
    assert result.returncode in (0, 1), result.stdout + result.stderr
    print(result.stdout)
    cases = ElementTree.parse(report).iter("testcase")
    return {
        f"{case.get('classname')}::{case.get('name')}": next(
            (child.tag for child in case if child.tag in ("failure", "error", "skipped")), "passed"
        )
        for case in cases
    }


@pytest.mark.timeout(300)
def test_the_tests_of_modbus_connection_pass_but_those_about_tmodbus(folder: Path) -> None:
    results = outcomes(folder)
    passed = {test for test, outcome in results.items() if outcome == "passed"}
    failed = {test for test, outcome in results.items() if outcome in ("failure", "error")}
    skipped = results.keys() - passed - failed
    assert failed - NOT_OURS.keys() == set()
    assert NOT_OURS.keys() - failed == set(), "these are about ours, too"
    assert skipped == set()
    assert len([test for test in passed if "sunspec" in test]) > 38
    assert len(passed) > 700
