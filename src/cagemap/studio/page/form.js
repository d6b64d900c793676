// The form of a bake, made of what the server says of its options.
const SEPARATOR = ', ';
const PLACEHOLDERS = {files: 'file, …', 'named files': 'name=file, …', 'name or file': 'name or file'};
const fileFields = [];  // selects of files and the endings that they take

export function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

export function fill(select, entries, value) {  // entries are texts, or [value, text]
  const pairs = entries.map(one => Array.isArray(one) ? one : [one, one]), key = JSON.stringify(pairs);
  if (select.dataset.entries !== key) {
    select.replaceChildren(...pairs.map(([id, text]) => element('option', {value: id, textContent: text})));
    select.dataset.entries = key;
  }
  if (select.value !== value) select.value = value;
}

export function matching(listing, suffixes) {
  return listing.filter(name => suffixes.some(end => end === '/' ? !/\.[^/.]+$/.test(name) : name.toLowerCase().endsWith(end)));
}

// A file as an option: its name, and its folder if that is not the studio's.
export function fileOption(name) {
  const folders = name.split(/[\\/]/), file = folders.pop(), named = folders.filter(one => one !== '..').join('/');
  if (folders[0] !== '..') return [name, name];
  return [name, `${file} (${named ? `folder ${named}` : 'folder above'})`];
}

export function showFiles(listing) {
  for (const {select, suffixes} of fileFields) {
    const value = select.value, found = matching(listing, suffixes);
    const names = [...new Set(value ? [...found, value] : found)];
    fill(select, [['', select.dataset.empty], ...names.map(fileOption)], value);
  }
}

function files(suffixes, empty) {
  const select = element('select');
  select.dataset.empty = empty;
  fileFields.push({select, suffixes});
  return select;
}

// What an image is most likely of, by its name.
export function lastWord(file) {
  const stem = file.replace(/^.*\//, '').replace(/\.[^.]*$/, '').replace('<UDIM>', '');
  return stem.split(/[^\p{L}\p{N}]+/u).filter(Boolean).pop()?.toLowerCase() ?? 'map';
}

// A field's element and what is asked for.
function field({kind, label, value, choices, usual, suffixes, least, most, step}) {
  switch (kind) {
    case 'flag': {
      const box = element('input', {type: 'checkbox', checked: !!value});
      return [box, () => box.checked];
    }
    case 'choice': case 'number': {
      if (choices) {
        const select = element('select');
        fill(select, usual === false ? choices : [['', 'default'], ...choices], String(value));
        return [select, () => select.value];
      }
      const number = element('input', {type: 'number', value, min: least ?? '', max: most ?? '', step: step ?? 'any'});
      return [number, () => number.validity.badInput ? 'no number' : number.value];  // its value would be empty: the default
    }
    case 'several': {
      const boxes = choices.map(one => [one, element('input', {type: 'checkbox'})]);
      const made = element('span', {className: 'several'}, ...boxes.map(([one, box]) => element('label', {}, box, ` ${one}`)));
      return [made, () => boxes.filter(([, box]) => box.checked).map(([one]) => one)];
    }
    case 'file': {
      const select = files(suffixes, '–');
      return [select, () => select.value];
    }
    case 'files': case 'named files': case 'name or file': {
      const text = element('input', {value: value ?? '', placeholder: PLACEHOLDERS[kind]}), select = files(suffixes, 'choose a file…');
      select.setAttribute('aria-label', `${label}: choose a file`);
      select.addEventListener('change', () => {
        const one = kind === 'named files' ? `${lastWord(select.value)}=${select.value}` : select.value;
        const before = text.value.split(',').map(word => word.trim()).filter(Boolean);
        if (one) text.value = kind === 'name or file' ? one : [...before, one].join(SEPARATOR);
        select.value = '';
      });
      return [element('span', {}, text, select), () => text.value];
    }
    default: {
      const text = element('input', {value: value ?? ''});
      return [text, () => text.value];
    }
  }
}

// Build the form; returns `values`, which gives changed options by key, and `forgetModels`, which empties names of files
// and gives options of an opened RESULT their defaults.
export function buildForm({first, folds}, above, below) {
  const asked = {}, usual = {}, ofModels = [], alwaysSent = new Set();
  const line = one => {
    const [made, value] = field(one);
    asked[one.key] = value;
    if (one.always_sent) alwaysSent.add(one.key);
    usual[one.key] = JSON.stringify(value());
    const name = element('span', {textContent: one.label});
    const several = one.kind === 'several', holder = element(several ? 'div' : 'label', {title: one.hint}, name, made);
    const inputs = made.matches('input, select') ? [made] : [...made.querySelectorAll('input, select')];
    if (one.kind.includes('file') || one.key === 'name') ofModels.push(...inputs.map(input => [input, '']));
    else if ('default' in one) ofModels.push([inputs[0], one.default]);
    for (const input of made.matches('input, select') ? [made] : made.querySelectorAll('input:not([type=checkbox])'))
      input.setAttribute('aria-label', one.label);
    holder.dataset.key = one.key;
    return holder;
  };
  fileFields.length = 0;
  above.replaceChildren(...first.map(line));
  below.replaceChildren(...folds.map(({title, fields}) =>
    element('details', {}, element('summary', {textContent: title}), ...fields.map(line))));
  return {
    values: () => Object.fromEntries(Object.entries(asked).map(([key, value]) => [key, value()])
      .filter(([key, value]) => JSON.stringify(value) !== usual[key] || alwaysSent.has(key))),
    forgetModels: () => { for (const [input, value] of ofModels) input[input.type === 'checkbox' ? 'checked' : 'value'] = value; },
  };
}
