// Decodes PSN and OSC with libraries from npm and prints one JSON line a packet: node receive.mjs
// OSC_PORT PSN_PORT
import dgram from 'node:dgram';
import { createRequire } from 'node:module';
import { resolve } from 'node:path';

// The libraries are installed beside the test's output, not beside this file.
const require = createRequire(resolve(process.env.RECEIVERS_HOME ?? '.', 'package.json'));
const { Decoder } = require('@jwetzell/posistagenet');
const { Server } = require('node-osc');

const [oscPort, psnPort] = process.argv.slice(2).map(Number);
const say = (line) => process.stdout.write(JSON.stringify(line) + '\n');
let ready = 0;
const isReady = () => { if (++ready === 2) say({ ready: true }); };

const osc = new Server(oscPort, '127.0.0.1', isReady);
osc.on('bundle', (bundle) => say({ osc: bundle.elements }));
osc.on('error', (error) => say({ error: `node-osc: ${error.message}` }));

const psn = dgram.createSocket('udp4');
psn.on('message', (packet) => {
  const decoder = new Decoder();
  try {
    decoder.decode(new Uint8Array(packet));
  } catch (error) {
    return say({ error: `posistagenet: ${error.message}` });
  }
  const trackers = Object.values(decoder.trackers instanceof Map ? Object.fromEntries(decoder.trackers) : decoder.trackers);
  say({ psn: trackers.map((t) => ({ id: t.id, pos: t.pos, ori: t.ori, status: t.status ?? t.validity, name: t.name })), system: decoder.systemName });
});
psn.bind(psnPort, '127.0.0.1', isReady);
