// Wakes whoever has this browser, while the page is closed: grave alerts come by its push service (docs/tablet.md).
export class Push {
  private on = false;

  constructor(private readonly say: (severity: number, words: string) => void) {
    void this.look();
  }

  item(wakes: boolean): { title: string; note: string; tick: boolean; refuse: string | undefined; do: () => void } {
    const lacks = !wakes ? "only a page that comes from the boat does this" : !("serviceWorker" in navigator && "PushManager" in window) ? "it needs HTTPS with a certificate that this device trusts" : undefined;
    return { title: "Wake me", note: "grave alerts come to this device, the page closed or not", tick: this.on, refuse: lacks, do: () => void this.toggle() };
  }

  private async manager(): Promise<PushManager | undefined> {
    return (await navigator.serviceWorker?.getRegistration())?.pushManager;
  }

  private async look(): Promise<void> {
    this.on = Boolean(await (await this.manager())?.getSubscription().catch(() => null));
  }

  private async toggle(): Promise<void> {
    try {
      await (this.on ? this.end() : this.begin());
      await this.look();
      this.say(6, this.on ? "grave alerts come to this device" : "no alert comes to this device any more");
    } catch (error) {
      this.say(4, `wake me: ${error instanceof Error ? error.message : error}`);
    }
  }

  private async begin(): Promise<void> {
    if ((await Notification.requestPermission()) !== "granted") throw new Error("this browser may not show notifications: allow it in its settings");
    const [manager, key] = [await this.manager(), await (await fetch("push")).text()];
    if (!manager) throw new Error("this device does not trust the boat’s certificate");
    await told("push", await manager.subscribe({ userVisibleOnly: true, applicationServerKey: key }));
  }

  private async end(): Promise<void> {
    const subscription = await (await this.manager())?.getSubscription();
    if (!subscription) return;
    await told("unpush", subscription);
    await subscription.unsubscribe();
  }
}

async function told(where: string, subscription: PushSubscription): Promise<void> {
  const { endpoint, keys } = subscription.toJSON();
  const answer = await fetch(where, { method: "POST", body: JSON.stringify({ endpoint, keys }) });
  if (!answer.ok) throw new Error((await answer.text()).trim());
}
