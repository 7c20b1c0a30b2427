"use strict";
/* Asks what serves this page what is new of the run, and shows it; asks it to stop the run. */
(() => {
  const PERIOD = 2000, LOST = 3, SURE = 6000;
  const live = document.getElementById("live");
  const [line, stop, answer, told] = ["line", "stop", "answer", "told"].map((name) => document.getElementById(name));
  const share = live.querySelector("progress");
  const figures = [...document.querySelectorAll("figure.drawn")];
  const versions = Object.fromEntries(figures.map((figure) => [figure.dataset.kind, JSON.parse(figure.querySelector("script").textContent).version]));
  let failures = 0;
  let asked = null;
  let answered = false; // what came of the button stays to be read as long as the run goes on

  function say(text) {
    answer.textContent = text;
    answer.hidden = !text;
  }

  function show(said) {
    if (said.layout !== live.dataset.layout) { location.reload(); return; }
    if (line.textContent !== said.line) line.textContent = said.line;
    line.className = `state ${said.state}`;
    document.title = said.title;
    if (said.share === null) share.removeAttribute("value");
    else share.value = said.share;
    if (told.innerHTML !== said.told) told.innerHTML = said.told; // tables and notes, escaped where they are made
    stop.disabled = !["starting", "running"].includes(said.state);
    for (const figure of figures) {
      const news = said.figures[figure.dataset.kind];
      if (!news || !news.data) continue;
      versions[figure.dataset.kind] = news.data.version;
      figure.querySelector("script").textContent = JSON.stringify(news.data);
      figure.querySelector("figcaption").textContent = news.caption;
      figure.querySelector(".drawing").setAttribute("aria-label", news.alt);
      figure.dispatchEvent(new Event("change"));
    }
  }

  async function look() {
    if (!document.hidden) {
      try {
        const found = await fetch(`state?${new URLSearchParams(versions)}`, { cache: "no-store" });
        const said = await found.json();
        failures = 0;
        if (said.error) say(said.error);
        else {
          if (!["running", "stopping"].includes(said.state)) answered = false;
          if (!asked && !answered) say("");
          show(said);
        }
      } catch {
        failures += 1;
      }
    }
    if (failures < LOST) { setTimeout(look, PERIOD); return; }
    line.className = "state lost";
    line.textContent = `${line.textContent} (as it was last seen: valvefsi watch has ended)`;
    stop.disabled = true;
  }

  stop.addEventListener("click", async () => {
    if (!asked) {
      stop.textContent = "Write a checkpoint and stop";
      asked = setTimeout(() => { asked = null; stop.textContent = "Stop the run"; }, SURE);
      return;
    }
    clearTimeout(asked);
    asked = null;
    stop.textContent = "Stop the run";
    stop.disabled = true;
    answered = true;
    try {
      say((await (await fetch("stop", { method: "POST" })).json()).said);
    } catch {
      say("The request did not arrive: valvefsi watch does not answer.");
    }
  });
  setTimeout(look, PERIOD);
})();
