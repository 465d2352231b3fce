// Tells the server which keys and buttons are held, as long as they are: letting go stops the arm,
// and so does all that keeps this page from telling: another window, a closed lid, a crash.
(() => {
  const KEYS = new Set(__KEYS__);
  const BEAT = 60;  // [ms]
  const held = new Set();
  let socket = null, tokenOfSocket = '', padWasHeld = false;
  // The server's clock as it last told it, and when that was [ms]. Each message gives it back: then
  // the server knows that the message is no older, however long it lay somewhere on its way.
  let clock = 0, heard = -Infinity;

  // viser shows this to the driver alone.
  const token = () =>
    document.querySelector('[data-playground-token]')?.dataset.playgroundToken ?? '';
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
    if (socket?.readyState === WebSocket.OPEN) {
      socket.send(JSON.stringify({clock, keys: [...held], pad: padHeld ? gamepad : null}));
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
  // A button of the page that stands for a key. Another finger's release lets go of it, too.
  let pressed = null;
  addEventListener('pointerdown', (event) => {
    const key = event.target.closest?.('[data-held]')?.dataset.held;
    if (key && event.button === 0) { pressed = key; held.add(key); changed(); }
  }, true);
  for (const end of ['pointerup', 'pointercancel', 'contextmenu']) {
    addEventListener(end, () => { if (held.delete(pressed)) changed(); }, true);
  }
  addEventListener('blur', letGo);
  addEventListener('pagehide', letGo);
  document.addEventListener('visibilitychange', () => { if (document.hidden) letGo(); });

  function hear(event) {
    const wasOld = performance.now() - heard > 2 * BEAT;
    clock = Number(event.data);
    heard = performance.now();
    if (wasOld) tell();  // the first message after a pause had an old clock, and did not count
  }
  // A connection is the driver's, for as long as viser shows the token that it began with. One
  // that ends comes again after a second: a new scene brings a new token first.
  let ended = -Infinity;
  function connect() {
    const mine = token();
    if (mine !== tokenOfSocket) {
      socket?.close();
      [socket, tokenOfSocket, ended] = [null, mine, -Infinity];
    }
    if (!mine || socket || performance.now() - ended < 1000) return;
    const begun = socket = new WebSocket(
      `ws://${location.host}/held?token=${encodeURIComponent(mine)}`);
    begun.onmessage = hear;
    begun.onclose = () => {
      if (socket === begun) [socket, ended] = [null, performance.now()];
    };
  }
  setInterval(() => { connect(); tell(); }, BEAT);
})();
