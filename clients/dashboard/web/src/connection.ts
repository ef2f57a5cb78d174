// The bridge's WebSocket: subscribes to what the page shows, publishes commands, comes back by itself.
import { FoxgloveClient, type Channel } from "@foxglove/ws-protocol";
import { decode } from "./decode";
import type { Live } from "./live";
import { STATES, STREAMS, type SessionCommand, type States, type Streams } from "./messages";

const RETRY = [250, 500, 1000, 2000];  // [ms]
const SILENCE = 3;       // without a byte for so long, ask whether the bridge is there [s]
const GIVE_UP = 2000;    // its answer must come within [ms]

const streams = new Set<string>(STREAMS);
const states = new Set<string>(STATES);

export function seconds(): number { return performance.now() / 1000; }

export class Connection {
  private client: FoxgloveClient | null = null;
  private socket: WebSocket | null = null;
  private channels = new Map<number, { name: string; channel: Channel }>();  // by subscription
  private commands = new Map<string, number>();  // client channels by topic
  private subject = "";
  private attempt = 0;
  private last = 0;
  private probing = false;

  onChange: () => void = () => {};
  onRefused: (why: string) => void = () => {};

  constructor(private readonly live: Live, private readonly url: string) {
    setInterval(() => void this.watch(), 1000);
    window.addEventListener("online", () => this.drop());
    this.open();
  }

  session(command: SessionCommand): boolean { return this.publish("session", "SessionCommand", command); }

  stop(active: boolean, reason: string): boolean {
    return this.publish("stop", "EmergencyStop", { active, reason });
  }

  private open(): void {
    const socket = new WebSocket(this.url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
    const client = new FoxgloveClient({ ws: socket });
    const mine = (): boolean => this.client === client;
    this.socket = socket;
    this.client = client;
    this.channels.clear();
    this.commands.clear();
    this.subject = "";
    this.last = seconds();
    client.on("error", () => {});  // a close follows
    client.on("close", () => { if (mine()) this.closed(); });
    client.on("status", (status) => {
      this.last = seconds();
      if (mine() && status.level >= 2) this.onRefused(status.message);
    });
    client.on("advertise", (channels) => { if (mine()) this.advertised(client, channels); });
    client.on("message", ({ subscriptionId, data }) => {
      this.last = seconds();
      const known = this.channels.get(subscriptionId);
      if (mine() && known) this.message(known.name, known.channel, data);
    });
  }

  private advertised(client: FoxgloveClient, channels: Channel[]): void {
    this.last = seconds();
    for (const channel of channels) {
      const [, product, subject, name] = channel.topic.split("/");
      if (product !== "secondskin" || !subject || !name || channel.encoding !== "cdr") continue;
      if (!streams.has(name) && !states.has(name)) continue;
      this.subject = subject;
      this.channels.set(client.subscribe(channel.id), { name, channel });
    }
    if (this.subject !== "" && !this.live.connected) {
      this.attempt = 0;
      this.live.connected = true;
      this.live.everConnected = true;
      this.onChange();
    }
  }

  private message(name: string, channel: Channel, data: ArrayBufferView): void {
    if (streams.has(name)) {
      this.live.offer(name as keyof Streams, () => decode(channel, data), seconds());
    } else {
      this.live.take(name as keyof States, decode(channel, data) as never);
    }
  }

  private publish(topic: string, schemaName: string, message: object): boolean {
    if (!this.client || !this.live.connected || this.socket?.readyState !== WebSocket.OPEN) return false;
    let channel = this.commands.get(topic);
    if (channel == undefined) {
      channel = this.client.advertise({
        topic: `/secondskin/${this.subject}/${topic}`, encoding: "json",
        schemaName: `secondskin_msgs/msg/${schemaName}`,
      });
      this.commands.set(topic, channel);
    }
    this.client.sendMessage(channel, new TextEncoder().encode(JSON.stringify(message)));
    return true;
  }

  private closed(): void {
    this.client = null;
    this.live.disconnect();
    this.onChange();
    const wait = RETRY[Math.min(this.attempt++, RETRY.length - 1)]!;
    setTimeout(() => { if (this.client == null) this.open(); }, wait);
  }

  private drop(): void {
    const client = this.client;
    if (client == null) return;
    this.closed();
    client.close();
  }

  // A cable that was pulled closes nothing: services report once a second, so silence is suspicious.
  private async watch(): Promise<void> {
    if (this.client == null || this.probing || seconds() - this.last < SILENCE) return;
    this.probing = true;
    try {
      await fetch("api/info", { cache: "no-store", signal: AbortSignal.timeout(GIVE_UP) });
      this.last = seconds();
      if (this.socket != null && this.socket.readyState > WebSocket.OPEN) this.drop();
    } catch {
      this.drop();
    }
    this.probing = false;
  }
}
