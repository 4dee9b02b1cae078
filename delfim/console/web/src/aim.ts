// A crosshair in the middle of the map, for use without a pointer: arrows move the map under it, Enter is a click there.
import type { Chart, Pixel } from "./chart";
import { make } from "./dom";
import type { Place } from "./wire";

const STEP_PX = 16;
const STEPS: Record<string, Pixel> = { ArrowUp: [0, -STEP_PX], ArrowDown: [0, STEP_PX], ArrowLeft: [-STEP_PX, 0], ArrowRight: [STEP_PX, 0] };

export class Aim {
  private readonly cross = make("i.aim");

  constructor(
    parent: HTMLElement,
    private readonly chart: Chart,
    private readonly at: { seen: (place: Place, pixel: Pixel) => void; chosen: (place: Place, pixel: Pixel) => void; added: (place: Place) => void },
  ) {
    this.cross.hidden = true;
    parent.append(this.cross);
    chart.map.on("postrender", () => {
      if (!this.cross.hidden) this.show();
    });
  }

  /** Show the crosshair; where it is shown already, put a waypoint there. */
  press(): void {
    if (!this.cross.hidden) return this.at.added(this.chart.middle()[0]);
    this.cross.hidden = false;
    this.show();
  }

  takes(key: string): boolean {
    if (this.cross.hidden) return false;
    const step = STEPS[key];
    if (step) this.chart.pan(step);
    else if (key === "Enter") this.at.chosen(...this.chart.middle());
    else if (key === "Escape") this.cross.hidden = true;
    else return false;
    return true;
  }

  private show(): void {
    const [place, pixel] = this.chart.middle();
    [this.cross.style.left, this.cross.style.top] = [`${pixel[0]}px`, `${pixel[1]}px`];
    this.at.seen(place, pixel);
  }
}
