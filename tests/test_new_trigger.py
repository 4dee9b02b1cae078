"""A new failsafe trigger: a function, its row, and its class in the table. It fires, says why, and the table is obeyed."""

from delfim.console.link import Link
from delfim.errors import DelfimError
from tests.afloat import running
from tests.enlarged import Enlarged

SEES = """def few_satellites(look: Look) -> str | None:
    navigation = look.state.navigation
    if navigation is None or navigation.satellites >= look.settings.failsafe.few_satellites.satellites:
        return None
    return f"{navigation.satellites} satellites"


"""
CLASS = '''class FewSatellites(Trouble, frozen=True):
    """Fewer satellites than the boat shall sail by."""

    satellites: Annotated[int, msgspec.Meta(ge=0, le=99)] = 4  # of those in use
    after_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 0.3  # for this long
    action: ActionName = "warn"


'''


def test_a_new_trigger_fires_and_its_reason_is_on_the_state_and_the_boat_does_what_the_table_says(tmp_path):
    copy = Enlarged(tmp_path / "copy")
    copy.row("delfim/vehicle/troubles.py", "class Trigger(IntEnum):", SEES)
    copy.row("delfim/vehicle/troubles.py", "    LOG = 12, log\n", "    FEW_SATELLITES = 16, few_satellites\n")
    copy.row("delfim/config.py", "class Failsafe(Table, frozen=True):", CLASS)
    copy.row(
        "delfim/config.py",
        "    log: LogNotWritable = LogNotWritable()",
        "    few_satellites: FewSatellites = FewSatellites()\n",
    )
    values = ("failsafe.few_satellites.satellites=11", 'failsafe.few_satellites.heading="hold"', "mavlink.enabled=false")
    with running(tmp_path, 14550, *values, package=copy.place) as command:
        state = {"mode": ""}
        while state["mode"] != "hold":
            words = {} if state["mode"] == "heading" else {"heading_deg": 90.0, "speed_mps": 1.0}
            try:
                with Link(command, 60.0) as link:
                    state = link.ask("heading" if words else "state", **words)
            except DelfimError:  # it does not run yet, or is not fit yet
                continue
        assert state["reason"] == "10 satellites"
        assert ("few_satellites", "10 satellites") in {(each["name"], each["reason"]) for each in state["notices"]}
    assert "few_satellites: 10 satellites: hold" in copy.told("log", "cat", "--events", "--json", str(tmp_path / "log"))
