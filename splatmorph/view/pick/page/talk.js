// What the page says to its server.

const TOKEN = new URLSearchParams(location.search).get("k");
const $ = (id) => document.getElementById(id);

function addressFor(path, query = {}) {
  return `${path}?${new URLSearchParams({ k: TOKEN, ...query })}`;
}

// The answer, or an Error with the server's own words.
async function heard(response) {
  if (response.ok) return response;
  const { error } = await response.json().catch(() => ({}));
  throw new Error(error ?? `the picker answers ${response.status}`);
}

async function reached(address, options) {
  try {
    return await fetch(address, options);
  } catch {
    throw new Error("the picker is not running any more: start it again, nothing is lost");
  }
}

async function ask(name, body) {
  const options = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body ?? {}) };
  return (await heard(await reached(addressFor(`/${name}`), options))).json();
}

const fetched = async (path, query) => heard(await reached(addressFor(path, query)));

async function fetchScene(path, query) {
  const { payload, ...scene } = await (await fetched(path, query)).json();
  return unpacked(scene, payload, () => {});
}

async function fetchImage(path, query) {
  return createImageBitmap(await (await fetched(path, query)).blob());
}
