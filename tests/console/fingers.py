"""A page that is worked by fingers alone, on a screen that says it is one: what tests do by mouse and keys becomes taps."""

from typing import Any

from tests.console.chain import PATIENCE_S
from tests.services.browser import Page

OPEN = "document.querySelector('.popup:not([hidden])')"
ITEM = "[...document.querySelectorAll('.popup .item')].find((e) => e.querySelector('.title').firstChild.data === {!r})"
MEANT = "new Promise((done) => setTimeout(done, 350))"  # a finger that comes sooner cannot have read the menu
ENTRIES = {"h": "Heading", "m": "Manual", "b": "Pause: hold here", "y": "Play mission"}  # in place of keys
UNDER_WAY = "document.querySelector('.selected .mode').dataset.state === 'on'"
AT = """(e => {
  e.scrollIntoView({ block: 'nearest' });
  const { x, y, width, height } = e.getBoundingClientRect(), at = [x + width / 2, y + height / 2];
  return [...at, e.contains(document.elementFromPoint(...at))];
})"""


class Fingers:
    """Of a page that `Page` works."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._field = 0
        self.taps = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._page, name)

    async def mouse(self, at: tuple[float, float]) -> None:
        self.taps += 1
        await self._page.touch("Start", at)
        await self._page.touch("End")

    async def tap(self, element: str) -> None:
        """Its middle, as soon as nothing covers it."""
        await self._page.until(f"Boolean({element}) && {AT}({element})[2]", PATIENCE_S)
        x, y, _ = await self._page.value(f"{AT}({element})")
        await self.mouse((x, y))

    async def choose(self, *titles: str) -> None:
        """Through the open menu, entry by entry."""
        for title in titles:
            its = ITEM.format(title)
            await self._page.until(f"Boolean({its})", PATIENCE_S)
            await self._page.value(MEANT)
            await self._page.until(f"!{its}.hasAttribute('aria-disabled')", PATIENCE_S)
            await self.tap(its)

    async def press(self, key: str, modifiers: tuple[str, ...] = ()) -> None:
        if key in ENTRIES:
            if key == "b":  # its menu says so from the time on that the page knows of the mode
                await self._page.until(UNDER_WAY, PATIENCE_S)
            await self._menu()
            await self.choose(ENTRIES[key])
        elif (key, modifiers) == ("z", ("Control",)):
            await self._menu()
            await self.choose("Mission", "Undo")
        elif key == "Enter" and await self._page.value(f"Boolean({OPEN})"):
            await self._page.value(MEANT)
            await self.tap(f"{OPEN}.querySelector('.choice .main')")
            self._field = 0
        elif key == "Enter":
            await self._menu()
        elif key in ("ArrowRight", "ArrowLeft"):
            await self._page.value(MEANT)
            await self.tap(
                f"{OPEN}.querySelectorAll('.field')[{self._field}].querySelectorAll('.stepper')[{int(key == 'ArrowRight')}]"
            )
        elif key == "ArrowDown":
            self._field += 1
        else:
            assert key.isdigit(), f"no finger presses {key!r}"
            await self._page.press(key, modifiers)  # of a speed from which a form begins

    async def _menu(self) -> None:
        """Of the selected boat."""
        await self.tap("document.querySelector('.selected .head')")
        await self._page.until(f"Boolean({OPEN})", PATIENCE_S)
