// Receives a VMC performer's datagrams and decodes them with osc-min, an OSC library from npm.
//
//   node check.mjs FRAMES    says "port N" on standard output, then, when so many frames came or 20 s are
//                            over, one line of JSON: [{size, messages: [{address, types, values}]}] a datagram
import dgram from "node:dgram";
import { fromBuffer } from "osc-min";

const frames = Number(process.argv[2]);
if (!(frames > 0)) {
  console.error("usage: check.mjs FRAMES");
  process.exit(2);
}

const datagrams = [];
let begun = 0;
const socket = dgram.createSocket("udp4");

function finish() {
  socket.close();
  console.log(JSON.stringify(datagrams));
  clearTimeout(late);
}
const late = setTimeout(finish, 20000);

socket.on("message", (bytes) => {
  const bundle = fromBuffer(bytes); // throws when anything is not as OSC says
  if (bundle.oscType !== "bundle") throw new Error(`expected a bundle, got a ${bundle.oscType}`);
  const messages = bundle.elements.map((element) => ({
    address: element.address,
    types: element.args.map((argument) => argument.type).join(" "),
    values: element.args.map((argument) => argument.value),
  }));
  if (messages[0].address === "/VMC/Ext/OK") begun += 1;
  if (begun > frames) finish();
  else if (begun > 0) datagrams.push({ size: bytes.length, messages });
});
socket.bind(0, "127.0.0.1", () => console.log(`port ${socket.address().port}`));
