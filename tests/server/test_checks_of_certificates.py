"""
When a TLS endpoint looks at certificates, and that it stops when it is closed.
"""

from __future__ import annotations

import asyncio

from libmodbus_py.server.limits import Limits, ServerStatistics
from libmodbus_py.server.tls import Handshakes
from tests.simulation.network import Network
from tests.support.certificates import Papers

PLACE = "tls://10.0.0.1:802"
INTERVAL = 10.0


def test_a_closed_endpoint_looks_at_no_certificate_any_more(papers: Papers) -> None:
    statistics = ServerStatistics()

    async def main() -> None:
        limits = Limits(certificate_interval=INTERVAL)
        handshakes = Handshakes(papers.server(), limits, statistics)
        handshakes.open(PLACE)
        for _ in range(3):
            assert statistics.certificate_ends.pop(PLACE) > 0
            await asyncio.sleep(INTERVAL - 0.5)
            assert statistics.certificate_ends == {}
            await asyncio.sleep(0.5 + 0.001)
        assert PLACE in statistics.certificate_ends
        for _ in range(2):
            handshakes.close()
            assert statistics.certificate_ends == {}
            await asyncio.sleep(5 * INTERVAL)
            assert statistics.certificate_ends == {}

    Network().run(main)
