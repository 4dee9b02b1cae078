// The page as an app: it opens without its gateway (sw.js), and never stays an old one at a new gateway.
const MINE = new URL(import.meta.url).search.slice(1); // of which build this page is
const TRIED = "delfim.built";

/** Browsers allow it over HTTPS with a certificate that they trust alone; without it the page works as ever. */
export function keepOffline(): void {
  if (location.protocol === "https:") navigator.serviceWorker?.register("sw.js").catch(() => {});
}

/** The gateway says of which build its page is: one that was kept from before makes way, once. */
export function makeWay(built: string): void {
  if (!built || built === MINE || sessionStorage.getItem(TRIED) === built) return;
  sessionStorage.setItem(TRIED, built);
  location.reload();
}
