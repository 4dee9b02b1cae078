"""The safety core: the files of which each change is noticed or has its reason, and the tests that are asked."""

from typing import Final

_FILES: Final = (
    *("propulsion/gate", "propulsion/propulsion", "failsafe/failsafe", "failsafe/troubles", "failsafe/checks"),
    *("helm/helm", "orders/handlers", "orders/kills", "control/control", "plans/fence", "plans/zones"),
)
_HANDS: Final = (
    *("parts/handset/operator", "parts/handset/killswitch"),
    *("lines/radiocontrol/channels", "lines/radiocontrol/crsf", "lines/radiocontrol/sbus"),
)
_TRAFFIC: Final = (
    *("alarm", "beside", "cpa", "encounter", "judged", "keepclear", "leash", "reckoning", "routeahead", "shoreline", "targets"),
    *("trialways", "troubles", "watchkeeper"),
)
_SERVICES: Final = (
    *("supervision/supervisor", "supervision/stop", "supervision/watchdog"),
    *("access/connection_limits", "access/exposure"),
)
_EXPOSURES: Final = tuple(map("delfim/parts/{}/exposure.py".format, ("fleet", "mavlink", "nmea0183", "payload", "ros")))
_HELM: Final = (  # through the loop
    *("alone", "charted", "entrusting", "failsafe_loop", "homeward", "loop", "pause", "restart"),
    *("reviews", "stations", "trial", "unstick"),
)
CORE: Final = (
    *map("delfim/vehicle/{}.py".format, _FILES),
    *map("delfim/{}.py".format, _HANDS),
    *map("delfim/parts/traffic/{}.py".format, _TRAFFIC),
    *map("delfim/services/{}.py".format, _SERVICES),
    *("delfim/parts/mavlink/codec/signing.py", "delfim/parts/pwm/outlet.py"),
    *_EXPOSURES,
)
TESTS: Final = (  # files that take long, and see nothing that others do not see, are not asked
    "tests/vehicle/test_*.py",
    *("tests/parts/traffic/test_*.py", "tests/parts/handset/test_*.py", "tests/parts/guest/test_*.py"),
    *("tests/parts/mavlink/test_*.py", "tests/parts/dronecan/test_*.py", "tests/parts/frontseats/test_*.py"),
    "tests/parts/nmea2000/test_nmea2000_drive.py",
    *("tests/parts/pwm/test_outlet.py", "tests/services/test_supervisor.py", "tests/services/test_shutdown.py"),
    *(
        "tests/services/test_connection_limits.py",
        "tests/test_deadman.py",
        "tests/test_security.py",
        "tests/parts/test_misbehaving_parts.py",
        "tests/parts/test_orders.py",
    ),
    *("tests/services/test_supervisor_turns.py", "tests/services/test_stop.py", "tests/services/test_exposure.py"),
    "tests/parts/energy/test_energy_trouble.py",
)
ABOUT: Final = {  # the tests of what is called by a row of a table, without an import
    "delfim/vehicle/orders/handlers.py": (
        "tests/vehicle/test_helm.py",
        "tests/vehicle/test_pause.py",
        "tests/vehicle/test_trial.py",
        "tests/parts/test_orders.py",
        "tests/vehicle/test_survey_lines.py",
    ),
    "delfim/vehicle/helm/helm.py": tuple(map("tests/vehicle/test_{}.py".format, _HELM)),
    "delfim/vehicle/failsafe/checks.py": ("tests/parts/test_orders.py",),
    "delfim/parts/traffic/troubles.py": ("tests/vehicle/test_troubles.py",),
    **dict.fromkeys(_EXPOSURES, ("tests/services/test_exposure.py",)),
}
NOT_ASKED: Final = "test_qgroundcontrol.py", "test_mavlink_fuzz.py", "test_handset_afloat.py"
