"""Names as levels of topics and subjects, and topics with names and labels."""

import pytest

from libmodbus_py import Fleet, Server
from libmodbus_py.fleet import FleetFileError, load
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.fleet.outputs.topics import Levels, Topic
from tests.services.fleet.fleets import meter, simulated, until
from tests.services.fleet.outputs.brokers import Broker, hearing, payloads, publish
from tests.support.cases import each_case

LEVELS = Levels(r"[\s.%/]")

NAMES = ["north", "hall.2", "a b", "50%", "%2E", "kälte", "日本", "/", "x" * 100]


def test_a_level_decodes_to_the_name_that_it_encodes() -> None:
    assert [LEVELS.read(LEVELS.spell(name)) for name in NAMES] == NAMES
    assert LEVELS.spell("hall.2 50%/kälte") == "hall%2E2%2050%25%2Fkälte"
    assert len({LEVELS.spell(name) for name in NAMES}) == len(NAMES)


SPELT_OTHERWISE = ["", "n%6Frth", "hall.2", "hall%2e2", "%", "%2", "%zz", "%FF", "%0A", "a\n"]

TOO_LONG = ["x" * 101, "%25" * 101, "a" * 100_000]


@each_case("level", [*SPELT_OTHERWISE, *TOO_LONG])
def test_a_level_in_another_spelling_is_refused(level: str) -> None:
    assert LEVELS.read(level) is None


TEMPLATE = "plant/{label.site}/{device}/{name}"


def topic(template: str = TEMPLATE) -> Topic:
    return Topic("topic", template, ("device", "name"))


def test_labels_are_levels_of_topics() -> None:
    template = topic()
    assert template.of({"site": "Halle"}, device="north", name="power") == "plant/Halle/north/power"
    assert template.of({"site": "a/b+#%"}, device="n/x", name="p") == "plant/a%2Fb%2B%23%25/n%2Fx/p"
    assert template.filter == "plant/+/+/+"
    assert template.read("plant/Halle/north/power") == {"device": "north", "name": "power"}
    assert template.read("plant/Halle/n%6Frth/power") is None
    assert template.read("plant/Halle/north") is None


def test_a_label_may_be_part_of_a_level() -> None:
    template = topic("site-{label.the site}/{device}/{name}")
    assert template.of({"the site": "1"}, device="a", name="b") == "site-1/a/b"


def test_labels_of_a_removed_device_are_unknown() -> None:
    assert topic().of({}, device="north", name="power") == "plant/unknown/north/power"


FLEET = """
[[device]]
name = "south"
url = "tcp://127.0.0.2"
LABELS
[[device.point]]
name = "level"
table = "holding_registers"
address = 0

[output.mqtt]
url = "mqtt://127.0.0.1"
topic = "plant/{label.site}/{device}/{name}"
"""


@each_case("labels", ["", 'labels = { place = "Hof" }', 'labels = { site = "" }'])
def test_a_device_without_the_label_is_an_error_of_the_file(labels, tmp_path) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(FLEET.replace("LABELS", labels))
    with pytest.raises(FleetFileError) as raised:
        load(file)
    message = "output.mqtt.topic: {label.site}: the device 'south' has no label 'site'"
    assert message in str(raised.value)
    line = FLEET.splitlines().index('topic = "plant/{label.site}/{device}/{name}"') + 1
    assert str(raised.value).startswith(f"{file}, line {line}: ")


async def test_a_device_without_the_label_is_not_added() -> None:
    with Server({1: simulated()}).background("tcp://127.0.0.1:0") as served:
        url = served.urls[0]
        output = Mqtt("mqtt://127.0.0.1:1", topic=TEMPLATE)
        async with Fleet([meter("a", url, labels={"site": "x"})], outputs=[output]) as fleet:
            with pytest.raises(ValueError, match="'b' has no label 'site'"):
                fleet.add([meter("b", url)])
            assert [*fleet.devices] == ["a"]
            fleet.add([meter("b", url, labels={"site": "y"})])
            assert [*fleet.devices] == ["a", "b"]
        with pytest.raises(ValueError, match="'a' has no label 'site'"):
            await Fleet([meter("a", url)], outputs=[output]).run(once=True)


@pytest.mark.parametrize(
    ("template", "reading", "other", "own"),
    [
        (
            TEMPLATE,
            "plant/Halle 1/north/power",
            "plant/Hof/north/setpoint/set",
            "plant/Halle 1/north/setpoint/set",
        ),
        ("plant/{device}", "plant/north", "plant/north/set", "plant/north/setpoint/set"),
    ],
    ids=["with labels", "without the name of a point"],
)
async def test_a_command_is_accepted_on_the_topic_of_its_point_only(
    broker: Broker, template: str, reading: str, other: str, own: str
) -> None:
    """A command to the topic of another site is none: rules of the broker go by topics."""
    device = simulated()
    with Server({1: device}).background("tcp://127.0.0.1:0") as served:
        states = "states/{label.site}/{device}"
        output = Mqtt(broker.url, topic=template, device_status=states, status="", commands=True)
        north = meter("north", served.urls[0], labels={"site": "Halle 1"})
        async with hearing(broker, "#") as messages, Fleet([north], outputs=[output]):
            await until(lambda: payloads(messages, reading))
            await until(lambda: payloads(messages, "states/Halle 1/north") == ["online"])
            await publish(broker, other, b"25")
            await publish(broker, own, b"21")
            await until(lambda: any(topic.endswith("/result") for topic, *_ in messages))
            [(topic, outcome)] = [
                (topic, outcome) for topic, outcome, _ in messages if topic.endswith("/result")
            ]
            assert (topic, outcome["ok"]) == (f"{own}/result", True)
            assert device.mapping.holding_registers[2] == 21
