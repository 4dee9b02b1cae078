// A page that failed says so in red until it is loaded again: a map that stands still must not look like calm water.
import { text } from "./dom";

export function tellFailures(box: HTMLElement): void {
  const tell = (error: unknown) => {
    text(box.querySelector("span")!, `What it shows may be old. STOP and the keys may still work. ${error}`);
    box.hidden = false;
  };
  window.addEventListener("error", ({ error }) => error && tell(error)); // without one it is the browser's notice about a layout
  window.addEventListener("unhandledrejection", ({ reason }) => tell(reason));
  box.querySelector("button")!.addEventListener("click", () => location.reload());
}
