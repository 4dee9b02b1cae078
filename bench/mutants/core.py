"""The safety core, whose changes are tried, and the tests that are asked."""

from typing import Final

_VEHICLE: Final = (
    *(
        "gate",
        "failsafe",
        "fence",
        "zones",
        "propulsion",
        "troubles",
        "checks",
        "control/control",
        "helm",
        "kills",
        "killswitch",
    ),
    *("handset/__init__", "handset/channels", "handset/crsf", "handset/sbus", "mavlink/signing"),
    *("traffic/keepclear", "traffic/watchkeeper"),
)
_SERVICES: Final = "outlet", "supervisor", "supervisorfile", "children", "door", "doors", "guestdoor"
CORE: Final = (*(f"delfim/vehicle/{name}.py" for name in _VEHICLE), *(f"delfim/services/{name}.py" for name in _SERVICES))
TESTS: Final = (  # files that take long, and see nothing that others do not see, are not asked
    "tests/vehicle/test_*.py",
    *("tests/services/test_outlet.py", "tests/services/test_supervisor.py", "tests/services/test_shutdown.py"),
    *("tests/services/test_door.py", "tests/test_deadman.py", "tests/test_security.py", "tests/test_new_trigger.py"),
)
NOT_ASKED: Final = "test_qgroundcontrol.py", "test_mavlink_fuzz.py"
