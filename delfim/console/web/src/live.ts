// A camera by WebRTC, straight from the boat: the film, and of each of its pictures when it was taken. It ends at the first doubt.
import type { Answer, Offer } from "./wire";

const ANSWER_MS = 12_000; // a slow computer aboard reads its library for seconds
const CONNECT_MS = 3000; // from the answer to the first picture
const STILL_MS = 1500; // without another picture
const LASTED_MS = 60_000;
const WORD_MS = 500;
const STATS_MS = 2000;
const LOSS_MAX = 0.1;
const STAMPS = 64;

interface Stats {
  type: string;
  packetsLost: number;
  packetsReceived: number;
}

export class Live {
  offer: Offer | null = null;
  private readonly peer = new RTCPeerConnection();
  private readonly word: RTCDataChannel;
  private readonly taken = new Map<number, [at_ms: number, same_s: number, taken_s: number]>(); // by the stamp of the picture
  private readonly timers: number[];
  private due_ms = performance.now() + ANSWER_MS;
  private first_ms = Infinity;
  private awaited = -1; // stamp of the picture on the page, while its time is not heard
  private lost = [0, 0];
  private wrong = false;

  static get possible(): boolean {
    return "RTCPeerConnection" in window && "requestVideoFrameCallback" in HTMLVideoElement.prototype;
  }

  /** `shown` is told the age of each picture on the page, since when it has not changed, and when it was taken. */
  constructor(
    private readonly video: HTMLVideoElement,
    private readonly shown: (age_s: number, same_s: number, taken_s: number) => void,
  ) {
    const { receiver } = this.peer.addTransceiver("video", { direction: "recvonly" });
    (receiver as { jitterBufferTarget?: number }).jitterBufferTarget = 0; // no picture waits for the sake of even motion
    this.word = this.peer.createDataChannel("times", { ordered: false, maxRetransmits: 0 });
    this.word.binaryType = "arraybuffer";
    this.word.onopen = () => this.say();
    this.word.onmessage = ({ data }) => this.heard(data as ArrayBuffer);
    this.peer.ontrack = ({ track }) => {
      video.srcObject = new MediaStream([track]);
      video.requestVideoFrameCallback((_, it) => this.drawn(it));
    };
    this.timers = [setInterval(() => this.say(), WORD_MS), setInterval(() => void this.count(), STATS_MS)];
  }

  get broken(): boolean {
    return this.wrong || performance.now() > this.due_ms || ["failed", "disconnected", "closed"].includes(this.peer.connectionState);
  }

  get lasted(): boolean {
    return performance.now() - this.first_ms > LASTED_MS;
  }

  async begin(): Promise<void> {
    const { sdp = "" } = await this.peer.createOffer();
    const found = (form: RegExp) => form.exec(sdp)?.[1]?.trim() ?? "";
    await this.peer.setLocalDescription({ type: "offer", sdp });
    this.offer = {
      payload: Number(found(/^a=rtpmap:(\d+) VP8/m)),
      certificate: found(/^a=fingerprint:sha-256 (.*)$/m).replaceAll(":", "").toLowerCase(),
      user: found(/^a=ice-ufrag:(.*)$/m),
      password: found(/^a=ice-pwd:(.*)$/m),
    };
  }

  take(answer: Answer): void {
    if (this.peer.signalingState !== "have-local-offer") return;
    const { payload } = this.offer!;
    const print = answer.certificate.replace(/..(?=.)/g, "$&:").toUpperCase();
    const end = (mid: number, kind: string, ...more: string[]) => [
      kind,
      "c=IN IP4 0.0.0.0",
      `a=mid:${mid}`,
      `a=ice-ufrag:${answer.user}`,
      `a=ice-pwd:${answer.password}`,
      `a=fingerprint:sha-256 ${print}`,
      "a=setup:active",
      `a=candidate:1 1 udp 1 ${answer.host} ${answer.port} typ host`,
      ...more,
    ];
    const atOnce = /^a=extmap:5 .*\/playout-delay$/m.exec(this.peer.localDescription!.sdp)?.[0]; // no picture is held back
    const video = [...(atOnce ? [atOnce] : []), "a=sendonly", "a=rtcp-mux", `a=rtpmap:${payload} VP8/90000`, `a=rtcp-fb:${payload} nack`, `a=rtcp-fb:${payload} nack pli`, `a=ssrc:${answer.ssrc} cname:boat`];
    const lines = ["v=0", "o=- 1 1 IN IP4 127.0.0.1", "s=-", "t=0 0", "a=group:BUNDLE 0 1", ...end(0, `m=video 9 UDP/TLS/RTP/SAVPF ${payload}`, ...video), ...end(1, "m=application 9 UDP/DTLS/SCTP webrtc-datachannel", "a=sctp-port:5000"), ""];
    this.due_ms = performance.now() + CONNECT_MS;
    this.peer.setRemoteDescription({ type: "answer", sdp: lines.join("\r\n") }).catch(() => (this.wrong = true));
  }

  /** The picture on the page as JPEG, in base64. */
  still(): string {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [this.video.videoWidth, this.video.videoHeight];
    canvas.getContext("2d")!.drawImage(this.video, 0, 0);
    return canvas.toDataURL("image/jpeg", 0.9).split(",")[1] ?? "";
  }

  close(): void {
    for (const each of this.timers) clearInterval(each);
    this.peer.close();
    this.video.srcObject = null;
  }

  /** The boat tells times by the clock of this page, of which it hears here. */
  private say(): void {
    if (this.word.readyState !== "open") return;
    const word = new DataView(new ArrayBuffer(8));
    word.setFloat64(0, performance.now());
    this.word.send(word.buffer);
  }

  private heard(data: ArrayBuffer): void {
    if (data.byteLength !== 22) return;
    const word = new DataView(data);
    this.taken.set(word.getUint32(0), [word.getFloat64(4), word.getUint16(12), Number(word.getBigUint64(14)) / 1000]);
    if (this.taken.size > STAMPS) this.taken.delete(this.taken.keys().next().value!);
    this.known();
  }

  private drawn(it: VideoFrameCallbackMetadata): void {
    if (!this.video.srcObject || this.peer.connectionState === "closed") return;
    this.video.requestVideoFrameCallback((_, next) => this.drawn(next));
    this.awaited = it.rtpTimestamp ?? -1;
    this.known();
  }

  /** Only a picture whose time is known counts as one: without it, its age would be a guess. */
  private known(): void {
    const taken = this.taken.get(this.awaited);
    if (!taken) return;
    this.awaited = -1;
    this.due_ms = performance.now() + STILL_MS;
    this.first_ms = Math.min(this.first_ms, performance.now());
    this.shown((performance.now() - taken[0]) / 1000, taken[1], taken[2]);
  }

  private async count(): Promise<void> {
    for (const each of (await this.peer.getStats()).values() as Iterable<Stats>) {
      if (each.type !== "inbound-rtp") continue;
      const [lost, came] = [each.packetsLost - this.lost[0]!, each.packetsReceived - this.lost[1]!];
      this.lost = [each.packetsLost, each.packetsReceived];
      if (lost > LOSS_MAX * (lost + came) && lost + came > 20) this.wrong = true;
    }
  }
}
