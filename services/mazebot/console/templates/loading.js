// In each page itself: a script or style sheet that does not come (where the machine's networks
// change meanwhile, a browser gives up) makes the page load again, and at last say so.
(() => {
  const TRIES = 5;
  const WAIT_MS = 1000;
  const KEY = `loads of ${location.pathname}`;
  let failed = false;

  function sayWhat(address) {
    const told = document.createElement("p");
    told.className = "notice bad";
    told.setAttribute("role", "alert");
    told.textContent = `This page is not complete: ${address} did not load. Reload the page.`;
    document.body.prepend(told);
  }

  addEventListener("error", ({ target }) => {
    if (!(target instanceof HTMLScriptElement || target instanceof HTMLLinkElement) || failed) {
      return;
    }
    failed = true;
    const count = Number(sessionStorage.getItem(KEY)) + 1;
    sessionStorage.setItem(KEY, count);
    if (count < TRIES) {
      setTimeout(() => location.reload(), WAIT_MS);
    } else {
      sessionStorage.removeItem(KEY);
      sayWhat(new URL(target.src || target.href).pathname);
    }
  }, true);

  addEventListener("load", () => {
    if (!failed) {
      sessionStorage.removeItem(KEY);
    }
  });
})();
