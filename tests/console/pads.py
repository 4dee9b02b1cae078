"""A gamepad that is none: Chromium has no way to plug one in here, so `navigator.getGamepads` of the page is replaced.
All behind it is real: the page, the gateway, the link and the vehicle."""

from tests.services.browser import Page

REST = 0.12  # of the way of a stick: gamepad.ts


async def plug(page: Page, right: float = 0.0, ahead: float = 0.0, *, stop: bool = False) -> None:
    """From now on there is one, with its left stick so far to the right and ahead, -1 to 1 beyond its rest. A browser says when
    it is plugged in, and no more."""
    axes = [_axis(right), -_axis(ahead)]
    buttons = f"[{{pressed: false}}, {{pressed: {str(stop).lower()}}}]"
    await page.value(f"""(() => {{
      const was = navigator.getGamepads().some(Boolean);
      navigator.getGamepads = () => [null, {{connected: true, axes: {axes}, buttons: {buttons}}}];
      if (!was) window.dispatchEvent(new Event('gamepadconnected'));
    }})()""")
    await looked(page)


async def unplug(page: Page) -> None:
    await page.value("navigator.getGamepads = () => [null, null], 0")
    await looked(page)


async def looked(page: Page) -> None:
    """The page has seen it; ten times a second it looks."""
    await page.value("new Promise(done => setTimeout(done, 250))")


def _axis(way: float) -> float:
    return 0.0 if not way else (REST + abs(way) * (1 - REST)) * (1 if way > 0 else -1)
