// How good a boat's link is: bars, the figures in words, and what a weak one means for a stop.
import type { Freshness } from "./state";
import type { Boat } from "./wire";

const WEAK_PCT = 10; // lost
const WEAK_MS = 1000;
const REPEAT_S = 0.2; // a stop is sent again so often (docs/console.md)
const MISSED = 0.001; // the part of stops that take longer than is told
const LOST_MOST = 0.99;
const SILENT_S = 3.5; // as the gateway has it

/** Bars of four: none on a link that is not heard, and null where there is no link. */
export function bars({ link }: Boat, age: Freshness): number | null {
  if (link.kind === "log") return null;
  const [lost_pct, rtt_ms] = [link.loss_pct ?? 0, link.rtt_ms ?? 0];
  if (age === "lost") return 0;
  if (lost_pct >= 3 * WEAK_PCT || rtt_ms >= 3 * WEAK_MS) return 1;
  if (lost_pct >= WEAK_PCT || rtt_ms >= WEAK_MS) return 2;
  return lost_pct >= WEAK_PCT / 5 || rtt_ms >= WEAK_MS / 2 ? 3 : 4;
}

/** The cause, where a command may come late: of a thousand stops one takes longer than it says, if losses are by chance. */
export function weakWords({ link }: Boat): string {
  const [lost, rtt_s] = [(link.loss_pct ?? 0) / 100, (link.rtt_ms ?? 0) / 1000];
  const causes = [lost >= WEAK_PCT / 100 && `${Math.round(100 * lost)} % lost`, rtt_s >= WEAK_MS / 1000 && `${rtt_s.toFixed(1)} s round trip`].filter(Boolean);
  if (link.kind === "log" || !causes.length) return "";
  const tries = Math.log(MISSED) / Math.log(Math.min(Math.max(lost, MISSED), LOST_MOST));
  return `link weak: ${causes.join(", ")}; a stop may take ${Math.ceil(rtt_s + tries * REPEAT_S)}\u00a0s`;
}

export function linkWords({ link }: Boat): string {
  if (link.kind === "log") return "from the boat's own log";
  const parts = [`${link.profile || "?"} ${link.rtt_ms === null ? "" : `${Math.round(link.rtt_ms)} ms`}`];
  if (link.loss_pct !== null) parts.push(`${link.loss_pct < 9.95 ? link.loss_pct.toFixed(1) : Math.round(link.loss_pct)} % lost`);
  parts.push(link.signed ? "signed" : "unsigned");
  return parts.join(" · ");
}

/** Which of several links carries what the boat tells, and how the others are; empty where there is one. */
export function linksWords({ link }: Boat): string {
  const all = link.all ?? [];
  if (all.length < 2) return "";
  const words = [...all].sort((a, b) => Number(b.used) - Number(a.used)).map(({ place, used, age_s, rtt_ms }) => {
    if (age_s > SILENT_S) return `${place} silent for ${Math.round(age_s)} s`;
    return used ? `by ${place}` : `${place} stands by${rtt_ms === null ? "" : `, ${Math.round(rtt_ms)} ms`}`;
  });
  return words.join(" · ");
}
