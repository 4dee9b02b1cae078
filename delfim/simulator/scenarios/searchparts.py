"""What a run that searches lays over the boat's file: parts that it has then, and troubles that last less long than at sea."""

from typing import Any, Final

Words = dict[str, Any]
SWIFT: Final[Words] = {  # troubles that need not last as long as at sea
    "console_silent": {"after_s": 1.5},
    "manual_silent": {"after_s": 1.4},
    "guest_silent": {"after_s": 1.0},
    "battery_low": {"after_s": 1.0},
    "battery_critical": {"after_s": 1.0},
    "fence_left": {"after_s": 0.5},
    "thruster": {"after_s": 3.0},  # a motor that is stopped coasts for two seconds
    "gnss_poor": {"after_s": 1.0},
    "shallow": {"after_s": 0.5},
    "ais_silent": {"after_s": 2.0},
    "log": {"after_s": 1.0},
    "navigation_frozen": {"after_s": 1.0},
    "clear_s": 1.0,
}
ON_A_BUS: Final[Words] = {"navigation": {"sources": ["nmea2000"], "rate_hz": 10.0, "estimator": True}}
PLAINLY: Final[Words] = {"navigation": {"sources": ["nmea2000"]}}  # without an estimator a lost heading is lost at once
ON_A_LINE: Final[Words] = {
    "navigation": {"sources": ["nmea0183"], "stale_s": 1.5},
    "nmea0183": {"ports": {"gnss": {"device": "/dev/gnss", "baud": 115200}}},
    "failsafe": {"gnss_poor": {"corrections_s": 5.0, "accuracy_m": 5.0}},
}
HANDSET: Final[Words] = {"device": "/dev/receiver", "kill": {"channel": 6}}
NODES: Final = ("propeller_starboard", "batteries_starboard", "gps")  # some that a boat with a motor by pulses has, too
