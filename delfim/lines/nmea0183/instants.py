"""The sentences of one GNSS receiver, put together by the instant that they tell of."""

from delfim.lines.nmea0183.sentences import Located


class Instants:
    """A receiver tells of one instant in several sentences, in an order of its own: GGA first or RMC first, VTG in between.
    The last of them completes the instant; which one that is, the instants before show. So a position goes on once, with the
    velocity of the same instant, and without waiting for sentences that say nothing of it. Some plotters say something else
    each second: after an instant that nothing completed, the next one goes on with its first sentence."""

    def __init__(self) -> None:
        self.position: tuple[float, float] | None = None  # rad, of this instant; None: none of its sentences has one, or ...
        self.has_fix = True  # ... one of them says that there is none
        self.day_s: float | None = None  # time of the UTC day
        self.told: tuple[float | None, object] = (None, None)  # time and position that went on last
        self._heard: list[str] = []  # formatters of this instant
        self._last, self._completing = "", ""
        self._went_on, self._hurries = False, False

    def hear(self, formatter: str, said: Located | None) -> bool:
        """A sentence with a position, or a VTG (None). Whether it completes the instant."""
        day_s = None if said is None else said.day_s
        is_later = day_s is not None and self.day_s is not None and day_s != self.day_s
        if is_later or formatter in self._heard:
            self._begin()
        self._heard.append(formatter)
        if said is not None:
            self.day_s = self.day_s if day_s is None else day_s
            self.has_fix = self.has_fix and said.fix != 0
            if said.latitude_rad is not None and said.longitude_rad is not None:
                self.position = said.latitude_rad, said.longitude_rad
        if not self._hurries and self._completing not in ("", formatter):
            return False
        goes_on, self._went_on = not (self._hurries and self._went_on), True
        return goes_on

    def _begin(self) -> None:
        """A new instant. One sentence that was lost, or one that comes with every tenth instant only, changes nothing."""
        last = self._heard[-1]
        if last == self._last or not self._completing:
            self._completing = last
        self._last, self._heard = last, []
        self._hurries, self._went_on = not self._went_on, False
        self.day_s, self.position, self.has_fix = None, None, True
