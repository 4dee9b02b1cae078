// Plans of other programs: a file that is dropped on the page or chosen becomes the plan, and the plan is saved as one. The gateway reads and writes them.
import type { Chart } from "./chart";
import { isChart } from "./chartfiles";
import type { ChartFiles } from "./chartfiles";
import type { Messages } from "./messages";
import { WAYPOINTS_MOST, cornerPlace, retraced, spoken, understood } from "./mission";
import type { Entry } from "./popup";
import { chosen, sent } from "./sending";
import type { State } from "./state";
import type { Survey } from "./survey";
import type { Mission, Place } from "./wire";

const ENDINGS = ".gpx,.kml,.geojson,.json,.shp,.plan,.waypoints,.txt";
const AREAS = /\.(geojson|json|kml|gpx|shp|plan)$/i; // which may hold an area instead
const KINDS: [string, string, string][] = [
  ["gpx", "GPX", "places alone"],
  ["kml", "KML", "places alone"],
  ["geojson", "GeoJSON", "with speed, acceptance and stay"],
  ["shp", "Shapefile", "places alone, in a ZIP file"],
  ["plan", "QGroundControl", "with actions, fence and home"],
  ["waypoints", "Mission Planner", "with actions"],
];
const FIT_PX = 120;

interface Told {
  mission: Mission;
  left: string; // of the file, and not of the plan
}

export class PlanFiles {
  constructor(
    private readonly chart: Chart,
    private readonly state: State,
    private readonly survey: Survey,
    private readonly messages: Messages,
    private readonly charts: ChartFiles,
    private readonly edit: (boat: number, mission: Mission) => void,
  ) {
    window.addEventListener("dragover", (event) => event.preventDefault()); // else the browser leaves the page for the file
    window.addEventListener("drop", (event) => {
      event.preventDefault();
      const files = [...(event.dataTransfer?.files ?? [])];
      if (!files[0] || this.state.replaying) return;
      void (files.some(isChart) ? this.charts.take(files) : this.take(files[0]));
    });
  }

  menu(): Entry[] {
    const { mission } = this.state.plan(this.state.planning);
    const none = mission.waypoints.length ? undefined : "the plan has no waypoints";
    const saved = KINDS.map(([kind, title, note]) => ({ title: `Save as ${title}`, note, refuse: none, do: () => void this.save(kind) }));
    return [{ title: "Open a file…", note: "or drop it on the map; undo brings this plan back", do: () => chosen(ENDINGS, (file) => void this.take(file)) }, "line", ...saved];
  }

  /** The way in a file becomes the plan; a file that has areas alone is one of a survey. */
  async take(file: File): Promise<void> {
    const told = await sent<Told>("plan", file);
    if (!told.mission) {
      if (told.refused?.includes("no way in it") && AREAS.test(file.name)) await this.survey.load(file);
      else this.messages.say(null, 3, `plan refused: ${told.refused}`);
      return;
    }
    const mission = understood(told.mission);
    const { waypoints } = mission;
    const plan = waypoints.length > WAYPOINTS_MOST ? { ...mission, waypoints: retraced(waypoints) } : mission;
    this.edit(this.state.planning, plan);
    this.chart.fit([...plan.waypoints, ...plan.fence.map(cornerPlace), ...(plan.home ? [plan.home] : [])] as Place[], FIT_PX);
    const thinned = plan === mission ? "" : `; ${waypoints.length} points became ${plan.waypoints.length} waypoints`;
    this.messages.say(null, told.left ? 4 : 6, `plan of ${file.name}${thinned}${told.left ? `; left out: ${told.left}` : ""}`);
  }

  private async save(kind: string): Promise<void> {
    const mission = spoken(this.state.plan(this.state.planning).mission);
    const answer = await fetch(`plan/${kind}`, { method: "POST", body: JSON.stringify(mission) }).catch(() => null);
    if (!answer?.ok) return this.messages.say(null, 3, `not saved: ${answer ? await answer.text() : "the console does not answer"}`);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await answer.blob());
    link.download = /filename="([^"]+)"/.exec(answer.headers.get("Content-Disposition") ?? "")?.[1] ?? `plan.${kind}`;
    link.click();
    URL.revokeObjectURL(link.href);
  }
}
