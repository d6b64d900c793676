// The page: shows the state that the server tells, and sends what the user does. See actions.py for the messages.
import {buildForm, element, fileOption, fill, matching, showFiles} from './form.js';
import {Views} from './view.js';

const $ = id => document.getElementById(id);
const SIDES = ['target', 'source'], BOXES = ['doubts', 'cages', 'linked', 'other_parts', 'symmetric'], AGAIN = 500, AS_FILED = [['', 'as the file says']];
let socket = null, state = null, fixed = null, listing = [], shownFiles = '', shownPair = '', picked = false, typed = null, received = 0;
let bakeForm = {values: () => ({}), forgetModels: () => {}};

const hint = (...texts) => $('empty').replaceChildren(...texts.map(words => element('p', {textContent: words})));
hint('This browser draws no 3D. Turn WebGL on, or open the page in another browser.');
const views = new Views($('views'), {
  click: ray => send('click', ray), probe: ray => send('probe', ray), move: ray => send('move', ray),
  select: number => send('select', {number}), hint: text => { $('status').textContent = text; },
});
hint('Drop the target here: the model that gets the texture or rig.\nOr press Open…', 'Drop the source here: the model that has it.\nOr press Open…');
window.studio = {views, get state() { return state; }};

// The server

function connect() {
  const one = socket = new WebSocket(`${location.protocol.replace('http', 'ws')}//${location.host}/socket`);
  one.binaryType = 'arraybuffer';
  one.onopen = () => { views.forget(); };
  one.onmessage = ({data}) => {
    const said = JSON.parse(data);
    if (said.fixed && !fixed) bakeForm = buildForm(said.form, $('first'), $('folds'));  // what is typed stays on a reconnect
    fixed = said.fixed ?? fixed;
    if (said.listing) showFiles(listing = said.listing);
    if (said.status) [state, received] = [said, performance.now()];
    if (state) show();
  };
  one.onclose = () => {
    $('status').textContent = 'The studio has ended or cannot be reached. Start it again with the same command: '
      + 'this page comes back by itself, and nothing is lost.';
    document.querySelector('footer').dataset.kind = 'gone';
    $('progress').hidden = $('cancel').hidden = true;
    showSeconds();
    setTimeout(connect, AGAIN);
  };
}
function send(what, fields = {}) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({do: what, ...fields}));
}
async function add(file, role, drop) {
  const head = new TextEncoder().encode(`${JSON.stringify({name: file.name, role, drop})}\n`);
  socket.send(new Blob([head, file]));
}

// What is shown

function show() {
  const {status, view, models} = state;
  document.querySelector('footer').dataset.kind = status.kind;
  text('status', status.text);
  $('progress').hidden = status.kind !== 'busy';
  if (status.fraction === null) $('progress').removeAttribute('value');
  else $('progress').value = status.fraction;
  $('cancel').hidden = !status.cancel;
  showSeconds();
  text('verdict', state.verdict);
  showMessages();
  showViews();
  showMap();
  showLandmarks();
  showBake();
  showModels();
  for (const name of BOXES) $(name).checked = view[name];
  $('other-parts-line').hidden = !SIDES.some(side => views.sides[side].parts.other_parts);
  $('symmetric').disabled = !state.symmetric;
  $('symmetric').parentElement.title = state.symmetric || !models ? 'Also place the mirror image of each new landmark'
    : 'Needs two models whose meshes are mirror symmetric';
}
function showSeconds() {  // beside the status, which screen readers say
  const busy = document.querySelector('footer').dataset.kind === 'busy';
  text('seconds', busy ? `${Math.round(state.status.seconds + (performance.now() - received) / 1000)} s` : '');
}
setInterval(showSeconds, 1000);
function text(id, words) { if ($(id).textContent !== words) $(id).textContent = words; }
// Whether the content of an element has changed since it was built: rebuilding an element loses clicks and focus.
const made = {};
function changed(id, value) {
  const before = made[id];
  made[id] = JSON.stringify(value);
  return made[id] !== before;
}

function showMessages() {
  const lines = [...state.messages].reverse().map(one => element('li', {className: one.kind, textContent: one.text}));
  $('log').querySelector('ol').replaceChildren(...lines);
  $('log').hidden = !lines.length;
  text('log-title', `Messages (${lines.length})`);
}

function showViews() {
  const {drawn, models, view} = state;
  $('empty').hidden = !!models || state.status.kind === 'busy';
  views.canvas.style.visibility = $('empty').hidden ? '' : 'hidden';  // models that are open no more
  const modes = fixed.modes.filter(one => one !== 'baked' || state.images.length);
  const entries = names => names.map(one => [one, one[0].toUpperCase() + one.slice(1)]);
  fill($('mode'), entries(modes), view.mode);
  const compared = modes.filter(one => one !== 'baked' || state.baked);  // the model is drawn with that image
  if ($('other').value && !compared.includes($('other').value)) compare('');
  fill($('other'), [['', '–'], ...entries(compared)], $('other').value);
  for (const side of SIDES) {
    const head = $(side).querySelector('h2'), {name = '', opened, parts = []} = models?.[side] ?? {};
    const part = opened ? `, ${opened} (1 of ${parts.length} parts)` : '';
    head.replaceChildren(side === 'target' ? 'Target ' : 'Source ', element('b', {textContent: name}), part);
    for (const kind of ['skin', 'curves', ...(view.cages ? ['cage'] : [])]) {
      const key = drawn[`${side}/${kind}`];
      if (key) views.load(side, kind, key);
    }
    const other = SIDES.find(one => one !== side);
    const marks = state.landmarks.filter(one => one[side]).map(one => ({
      number: one.number, name: one.name, color: one.color, at: one[side], place: side === 'target' ? one[other] : null,
      solid: one.proposed !== side, selected: one.number === state.selected, wrong: !!one.wrong}));
    const asked = state.probe?.[side];
    if (asked) marks.push({number: 0, name: '', color: '#fff', at: [...asked, 0, 0, 0], place: null, solid: true, selected: true});
    views.setMarks(side, view.pose ? [] : marks);
  }
  views.set({look: view.mode, doubts: view.doubts, cages: view.cages, linked: view.linked, other_parts: view.other_parts, pose: view.pose});
  fill($('pose'), [['', 'at rest'], ...state.poses], view.pose);
  $('pose-line').hidden = !state.poses.length;
  $('wrapAmount').disabled = $('overlay').disabled = !state.revision;
  if (!state.revision) setWrap(0);
}
function compare(mode) {
  $('other').value = mode;
  $('split').hidden = !mode;
  views.set({other: mode});
}
function setWrap(amount) {
  $('wrapAmount').value = amount;
  views.set({wrapAmount: amount});
}

function showMap() {
  const {answers, chosen} = state;
  if (changed('answers', answers)) {
    const heading = answers.length ? [element('h2', {textContent: 'Possible alignments'})] : [];
    $('answers').replaceChildren(...heading, ...answers.map((name, index) =>
      element('button', {textContent: `${index + 1} · ${name}`, onclick: () => send('answer', {index})})));
  }
  $('answers').querySelectorAll('button').forEach((button, index) => button.setAttribute('aria-pressed', index === chosen));
  $('said').replaceChildren(...state.said.map(line => element('p', {textContent: line})));
  $('why').hidden = !state.said.length;
  $('again').disabled = !state.models;
}

function showLandmarks() {
  const {landmarks, count, curves, selected, saved} = state;
  $('list').hidden = !landmarks.length;
  text('count', !state.models ? '' : !landmarks.length ? 'No landmarks. Where the map is wrong, click that place on one model, then on the other.'
    : `${count} landmark${count === 1 ? '' : 's'}${curves ? `, ${curves} curves` : ''}${saved ? '' : ' · not saved yet'}`);
  showRows([...landmarks].reverse().sort((a, b) => !!b.wrong - !!a.wrong));
  for (const row of $('list').querySelectorAll('tbody tr')) {
    const isSelected = Number(row.dataset.number) === selected;
    row.setAttribute('aria-selected', isSelected);
    row.querySelector('button').setAttribute('aria-pressed', isSelected);
  }
  const item = landmarks.find(one => one.number === selected);
  $('selected').hidden = !item;
  if (item && (document.activeElement !== $('name') || typed?.number !== item.number)) $('name').value = item.name;
  $('undo').disabled = !state.undo;
  $('redo').disabled = !state.redo;
  $('accept').disabled = !state.proposal;
  $('next').disabled = !state.suggests;
  $('mirror').disabled = !item?.complete || !state.symmetric;
}

function select(number) {
  send('select', {number});
  views.reveal(state.landmarks.find(one => one.number === number));
}

function showRows(landmarks) {
  if (!changed('rows', landmarks.map(({number, name, color, complete, strain, wrong}) => [number, name, color, complete, strain, wrong])))
    return;
  const body = $('list').querySelector('tbody'), focused = document.activeElement.closest('#list tr')?.dataset.number;
  body.replaceChildren(...landmarks.map(one => {
    const off = !one.complete ? '…' : one.strain === null ? '' : `${(100 * one.strain).toFixed(1)} %`;
    const dot = element('i');
    dot.style.background = one.color;
    const row = element('tr', {className: one.wrong ? 'wrong' : '', title: one.wrong, onclick: () => select(one.number)},
      element('td', {}, dot, String(one.number)), element('td', {}, element('button', {textContent: one.name + (one.wrong ? ' ⚠' : '')})),
      element('td', {textContent: off}));
    row.dataset.number = one.number;
    return row;
  }));
  if (focused) body.querySelector(`[data-number="${focused}"] button`)?.focus();
}

function showBake() {
  const first = !state.revision && state.status.kind === 'busy';  // a bake beside the first match would match twice
  $('start').disabled = !state.models || state.baking || first;
  text('bake-hint', state.bake_hint);
  const links = state.outputs.map(({what, name, page}) => {
    const link = element('a', {href: `files/${encodeURIComponent(name)}`, textContent: name});
    if (page) Object.assign(link, {target: '_blank', rel: 'noopener'});
    return element('div', {}, `${what}: `, link);
  });
  if (changed('outputs', state.outputs)) {
    $('outputs').replaceChildren(...links);
    if (state.outputs.length) send('list');
  }
  $('baked-line').hidden = !state.images.length;
  fill($('baked'), [['', 'the map, as chosen under Show'], ...state.images], state.view.mode === 'baked' ? state.baked : '');
}

function showModels() {
  const {files, models} = state, dialog = $('models').querySelector('form'), pair = state.pair.join('\n') || shownPair;  // a restarted studio has none at first
  if (shownPair && pair !== shownPair) bakeForm.forgetModels();  // options of the bake belong to the models before
  shownPair = pair;
  for (const side of SIDES) {
    const model = models?.[side], parts = model?.parts ?? [];
    fill($(`part-${side}`), [...(model?.whole ? [['', 'the whole file']] : []), ...parts.map(([name, faces]) => [name, `${name} (${faces.toLocaleString('en')} faces)`])], model?.opened ?? '');
    $(`part-${side}`).parentElement.hidden = !parts.length;
    $(`plain-${side}`).hidden = !model?.dense;
  }
  const {meshes, images, landmarks} = fixed.kinds, none = [['', '–']], fields = dialog.elements;
  const opened = !picked && shownFiles !== JSON.stringify(files);  // what the user chose in the dialog stays
  if (opened) shownFiles = JSON.stringify(files);
  for (const [name, suffixes] of [['target', meshes], ['source', meshes], ['texture', images]]) {
    const known = opened ? files?.[name] ?? '' : fields[name].value, found = matching(listing, suffixes);
    const empty = name === 'texture' ? [['', 'the one in the source, if any']] : none;
    fill(fields[name], [...empty, ...[...new Set(known ? [known, ...found] : found)].map(fileOption)], known);
  }
  for (const id of ['pairs', 'points']) fill($(id), [...none, ...matching(listing, landmarks).map(fileOption)], $(id).value);
  if (!opened) return;
  SIDES.forEach((side, i) => {
    fill($(`scheme-${side}`), [...AS_FILED, ...fixed.schemes], files?.schemes[i] ?? '');
  });
  fill($('file-form'), fixed.forms.map(([name, ending]) => [ending, name]), fixed.forms[0][1]);
  $('file').value = files?.landmarks ?? '';
}

// What the user does

const on = (id, what, done) => $(id).addEventListener(what, done);
for (const name of ['undo', 'redo', 'accept', 'again', 'cancel', 'next']) on(name, 'click', () => send(name));
on('next', 'click', () => {
  views.reveal({target: state.suggests});
  $('target').focus({preventScroll: true});  // Enter then accepts the proposed place
});
for (const name of BOXES)
  on(name, 'change', () => send('view', {fields: {[name]: $(name).checked}}));
on('mode', 'change', () => send('view', {fields: {mode: $('mode').value}}));
on('pose', 'change', () => send('view', {fields: {pose: $('pose').value}}));
on('other', 'change', () => compare($('other').value));
on('split', 'input', () => views.set({split: Number($('split').value)}));
on('wrapAmount', 'input', () => setWrap(Number($('wrapAmount').value)));
on('overlay', 'change', () => views.set({overlay: $('overlay').checked}));
on('numbers', 'change', () => { views.set({numbers: $('numbers').checked}); showViews(); });
on('frame', 'click', () => views.frame());
on('theme', 'click', () => {
  const dark = document.documentElement.dataset.theme ?? (matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light');
  theme(dark === 'dark' ? 'light' : 'dark');
});
function theme(name) {
  document.documentElement.dataset.theme = name;
  localStorage.setItem('theme', name);
}
if (localStorage.getItem('theme')) theme(localStorage.getItem('theme'));

on('name', 'input', () => {
  typed = {number: state.selected};
  send('rename', {number: state.selected, name: $('name').value});
});
on('name', 'blur', () => { typed = null; });
on('mirror', 'click', () => send('mirror', {number: state.selected}));
on('delete', 'click', () => send('remove', {number: state.selected}));
on('save', 'click', () => { send('save', {name: $('file').value}); send('list'); });
on('load', 'click', () => send('load', {pairs: $('pairs').value, points: $('points').value}));
on('file-form', 'change', () => {
  const name = $('file').value, ends = fixed.forms.map(one => one[1]).sort((a, b) => b.length - a.length);
  const old = ends.find(end => name.toLowerCase().endsWith(end)) ?? '';
  $('file').value = name.slice(0, name.length - old.length) + $('file-form').value;
});
on('start', 'click', () => send('bake', {options: bakeForm.values()}));
on('baked', 'change', () => send('baked', {name: $('baked').value}));

for (const tab of document.querySelectorAll('[role=tab]')) {
  tab.addEventListener('click', () => {
    for (const one of document.querySelectorAll('[role=tab]')) {
      one.setAttribute('aria-selected', one === tab);
      $(one.getAttribute('aria-controls')).hidden = one !== tab;
    }
  });
}

const form = $('models').querySelector('form');
on('open', 'click', () => { send('list'); $('models').showModal(); });
form.addEventListener('change', event => { picked ||= !event.target.id.startsWith('part-') && event.target.id !== 'add'; });
form.elements.source.addEventListener('change', () => {  // an image named after the source is most likely its texture
  const stem = form.elements.source.value.replace(/^.*\//, '').replace(/\.[^.]*$/, '');
  const named = [...form.elements.texture.options].find(one => one.value.replace(/^.*\//, '').startsWith(stem) && one.value);
  form.elements.texture.value = named?.value ?? '';
});
SIDES.forEach((side, i) => {  // how the open model is taken is not said of another one
  form.elements[side].addEventListener('change', () => {
    if ($(`scheme-${side}`).value === (state.files?.schemes[i] ?? '')) $(`scheme-${side}`).value = '';
  });
  on(`part-${side}`, 'change', () => send('part', {side, part: $(`part-${side}`).value || null}));
  on(`plain-${side}`, 'click', () => send('as_it_is', {side}));
  on(`turn-${side}`, 'click', () => send('turn_up', {side}));
});
on('models', 'close', () => {
  if ($('models').returnValue === 'open') send('open', {
    ...Object.fromEntries(['target', 'source', 'texture'].map(name => [name, form.elements[name].value])),
    schemes: SIDES.map(side => $(`scheme-${side}`).value)});
  $('models').returnValue = '';
  [picked, shownFiles] = [false, ''];
  if (state) showModels();
});
const is = (file, kind) => matching([file.name], kind).length > 0;
const rank = file => is(file, fixed.kinds.meshes) ? 2 : is(file, ['.mtl']) ? 1 : 0;
const namedFirst = files => files.sort((a, b) => rank(a) - rank(b));  // files that others name come before these
const newDrop = () => `${Math.random()}`;  // a mesh is added with the material files of its own drop
on('add', 'change', () => {
  const added = newDrop();
  for (const file of namedFirst([...$('add').files])) add(file, null, added);
  $('add').value = '';
});

const drop = $('views'), half = event => event.clientX < $('source').getBoundingClientRect().left ? 'target' : 'source';
drop.addEventListener('dragover', event => {
  event.preventDefault();
  drop.classList.add('dropping');
  drop.dataset.drop = half(event) === 'target' ? 'Open here as the target, which gets the texture or rig' : 'Open here as the source, which has it';
});
drop.addEventListener('dragleave', () => drop.classList.remove('dropping'));
drop.addEventListener('drop', event => {
  event.preventDefault();
  drop.classList.remove('dropping');
  const files = [...event.dataTransfer.files], side = half(event), dropped = newDrop();
  const withMesh = files.some(file => is(file, fixed.kinds.meshes));
  // Images of a drop with a mesh belong to its materials; a single one is also the source's texture, once the mesh is open.
  const images = withMesh ? files.filter(file => is(file, fixed.kinds.images)) : [];
  for (const file of namedFirst(files)) add(file, images.includes(file) ? null : side, dropped);
  if (side === 'source' && images.length === 1) add(images[0], side, dropped);
});

document.addEventListener('keydown', event => {
  if (event.target.matches('input:not([type=checkbox]):not([type=range]), select, textarea') || $('models').open) return;
  const command = event.ctrlKey || event.metaKey;
  const key = event.key.toLowerCase();
  if (command && key === 'z') send(event.shiftKey ? 'redo' : 'undo');
  else if (command && key === 'y') send('redo');
  else if (command) return;
  else if ((key === 'delete' || key === 'backspace') && state?.selected) send('remove', {number: state.selected});
  else if (key === 'enter' && state?.proposal && !event.target.matches('button, summary, a')) send('accept');
  else if (key === 'escape') send('select', {number: null});
  else if (key === 'f') views.frame();
  else if ('137'.includes(key)) views.viewAlong(key);
  else return;
  event.preventDefault();
});

connect();
