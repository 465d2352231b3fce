// Tells the server which keys and buttons are held, as long as they are: letting go stops the arm,
// and so does all that keeps this page from telling: another window, a closed lid, a crash.
(() => {
  const KEYS = new Set(__KEYS__);
  const BEAT = 60;  // [ms]
  const held = new Set();
  let socket = null, padWasHeld = false;

  // viser shows this to one visitor each, so that the server knows whose keys these are.
  const token = () => document.querySelector('[data-playground-token]')?.dataset.playgroundToken;
  // A list keeps the keyboard after a choice; it takes letters only while it is open.
  const isClosedList = (element) => element.getAttribute('aria-haspopup') === 'listbox'
    && element.getAttribute('aria-expanded') !== 'true';
  const writes = (element) => element instanceof HTMLElement && (
    element.isContentEditable || element.tagName === 'TEXTAREA'
    || (element.tagName === 'INPUT' && !isClosedList(element)
        && !['checkbox', 'range', 'radio'].includes(element.type)));

  function pad() {
    const found = [...(navigator.getGamepads?.() ?? [])].find((one) => one && one.connected);
    if (!found) return null;
    return {axes: [...found.axes].slice(0, 8).map((x) => Math.round(x * 1000) / 1000),
            buttons: found.buttons.slice(0, 20).map((b) => b.pressed)};
  }

  function tell() {
    const gamepad = pad();
    const padHeld = gamepad !== null && gamepad.buttons.some((pressed) => pressed);
    if (!held.size && !padHeld && !padWasHeld && !tell.changed) return;
    padWasHeld = padHeld;
    tell.changed = false;
    if (socket?.readyState === WebSocket.OPEN && token()) {
      socket.send(JSON.stringify({token: token(), keys: [...held], pad: padHeld ? gamepad : null}));
    }
  }
  function changed() { tell.changed = true; tell(); }
  function letGo() { if (held.size || padWasHeld) { held.clear(); changed(); } }

  // Before viser hears of it, which would move the camera.
  addEventListener('keydown', (event) => {
    if (!KEYS.has(event.code) || writes(event.target) || event.ctrlKey || event.metaKey
        || event.altKey || !token()) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat && !held.has(event.code)) { held.add(event.code); changed(); }
  }, true);
  addEventListener('keyup', (event) => {
    if (held.delete(event.code)) { event.stopImmediatePropagation(); changed(); }
  }, true);
  addEventListener('blur', letGo);
  addEventListener('pagehide', letGo);
  document.addEventListener('visibilitychange', () => { if (document.hidden) letGo(); });

  function connect() {
    socket = new WebSocket(`ws://${location.host}/held`);
    socket.onclose = () => setTimeout(connect, 1000);
  }
  connect();
  setInterval(tell, BEAT);
})();
