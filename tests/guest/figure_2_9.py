"""Figure 2-9 of the thesis on this machine: python tests/guest/figure_2_9.py OUTPUT.png [SECONDS]

Round trips of the console's packet over a CSLIP line of 100 kbit/s between a guest's two ends: alone, beside a download, and
beside a download with IPTOS_LOWDELAY.
"""

import sys
import tempfile
from pathlib import Path
from statistics import median

from matplotlib.figure import Figure

from delfim.logging.ashore.plot import INK
from tests.guest.test_guest_slip import sailed

ROWS = (("idle_ms", "nothing else", "#5b9a68"), ("loaded_ms", "beside a download", "#d1495b"))
ROWS += (("lowdelay_ms", "beside a download, IPTOS_LOWDELAY", "#2e86ab"),)


def main(output: Path, seconds: float) -> None:
    with tempfile.TemporaryDirectory() as place:
        report = sailed(Path(place), "cslip", "kernel", seconds)
    sheet = Figure(figsize=(8.0, 3.6), layout="constrained", facecolor="white")
    axes = sheet.subplots()
    for key, label, colour in ROWS:
        trips = report[key]
        axes.plot(
            [n / 2 for n in range(len(trips))], trips, "o-", ms=3, lw=1, color=colour, label=f"{label}: {median(trips):.0f} ms"
        )
    axes.axhline(100.0, color=INK, lw=0.8, ls=":")
    axes.set(
        xlabel="s", ylabel="round trip, ms", ylim=(0, None), title="CSLIP, 100 kbit/s, MTU 296: a packet of 100 bytes and back"
    )
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    sheet.savefig(output, dpi=110)
    print({key: round(median(report[key])) for key, _, _ in ROWS}, round(report["bytes_per_s"]), "B/s")


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 20.0)
