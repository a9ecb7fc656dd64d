"""
Two pages with one token, in one browser: each shows its own server, and ends alone.
"""

from __future__ import annotations

from libmodbus_py.page import live_page
from tests.tools.page.watching import Visitor, made_server

TOKEN = "Bookmarked-by_the-plant-2026"


def test_two_pages_on_one_token_do_not_meet() -> None:
    one, other = made_server(), made_server()
    with live_page(other, token=TOKEN) as second:
        second_visitor = Visitor(second.url)
        with live_page(one, token=TOKEN) as first:
            visitors = [Visitor(first.url), second_visitor]
            # A browser sends the cookies of all ports of a host to each of them.
            cookies = "; ".join(each.headers["Cookie"] for each in visitors)
            for each in visitors:
                each.headers["Cookie"] = cookies
                assert each.ask("GET", "/")[0] == 200
            assert visitors[0].ask("GET", "/", Origin=f"http://{second_visitor.host}")[0] == 403
            with visitors[0].watching(), second_visitor.watching():
                # Streams of one page are unknown to the other.
                view = {"unit": 1, "what": "coils", "first": 0, "stop": 1}
                stream = visitors[0].seen["stream"]
                assert visitors[0].post("/view", stream=stream, **view) == {}
                assert second_visitor.post("/view", stream=stream, **view) != {}
        with Visitor(second.url).watching() as still_there:
            still_there.look(2, "holding_registers", 0, 8)


def test_two_pages_of_one_server_on_one_token_both_follow_it() -> None:
    server = made_server()
    with (
        server.background("tcp://127.0.0.1:0"),
        live_page(server, token=TOKEN) as first,
        live_page(server, token=TOKEN) as second,
        Visitor(first.url).watching() as one,
        Visitor(second.url).watching() as other,
    ):
        for each in (one, other):
            each.look(2, "holding_registers", 0, 8)
        place = {"unit": 2, "table": "holding_registers", "address": 3, "order": "ABCD"}
        assert one.post("/value", **place, type="uint16", text="1234") == {}
        for each in (one, other):
            each.receive(lambda each=each: "1234" in str(each.seen["cells"]))  # type: ignore[misc]
