// Compiles the WGSL files of a folder with Tint, Chrome's compiler, and makes a pipeline of each entry
// point on a device with WebGPU's default limits. tests/tint.sh runs it; no GPU is needed.
import { readdirSync, readFileSync } from 'node:fs';
import { join } from 'node:path';
import { create } from 'webgpu';

const folder = process.argv[2];
// Dawn's null backend has every feature and runs nothing.
const gpu = create(['backend=null']);
const adapter = await gpu.requestAdapter();
const device = await adapter.requestDevice({ requiredFeatures: ['subgroups'] });

/** Messages of Tint or Dawn about a WGSL text; none if all is well. */
async function faults(code) {
  device.pushErrorScope('validation');
  const module = device.createShaderModule({ code });
  const { messages } = await module.getCompilationInfo();
  const told = messages.map((m) => `${m.lineNum}:${m.linePos}: ${m.type}: ${m.message}`);
  const compiled = (await device.popErrorScope()) === null;
  if (!compiled) return told.length > 0 ? told : ['refused without a reason'];
  const entries = [...code.matchAll(/@compute[^{]*?\bfn\s+(\w+)/g)].map((match) => match[1]);
  if (entries.length === 0) told.push('no entry point');
  for (const entryPoint of entries) {
    device.pushErrorScope('validation');
    device.createComputePipeline({ layout: 'auto', compute: { module, entryPoint } });
    const error = await device.popErrorScope();
    if (error !== null) told.push(`${entryPoint}: ${error.message}`);
  }
  return told;
}

// What it must notice.
const probes = [
  '@compute @workgroup_size(8) fn main( {}',
  '@compute @workgroup_size(8) fn main() { _ = subgroupAdd(1u); }',
  '@compute @workgroup_size(257) fn main() {}',
  'var<workgroup> w: array<u32, 4097>; @compute @workgroup_size(8) fn main() { w[0] = 1u; }',
];
for (const probe of probes) {
  if ((await faults(probe)).length === 0) throw new Error(`Tint takes ${probe}`);
}

const files = readdirSync(folder).filter((file) => file.endsWith('.wgsl')).sort();
if (files.length === 0) throw new Error(`no shaders in ${folder}`);
let failed = 0;
for (const file of files) {
  const told = await faults(readFileSync(join(folder, file), 'utf8'));
  told.forEach((line) => console.log(`${file}:${line}`));
  failed += told.length > 0 ? 1 : 0;
}
console.log(`${files.length - failed} of ${files.length} shaders compile with Tint`);
device.destroy();
// Dawn's instance must not be collected before: what waits for it would wait for ever.
void gpu;
process.exit(failed > 0 ? 1 : 0);
