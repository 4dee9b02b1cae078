// Sections come as they change, and replace themselves. A page that is old must not look alive: it says so and fades.
"use strict";
const late = document.getElementById("late"), LATE_S = 4, AGAIN_S = 15;
const period = Number(new URLSearchParams(location.search).get("every")) || 1;
let heard = Date.now(), tried = heard, events;

function open() {
  tried = Date.now();
  events = new EventSource("/events" + location.search);
  events.onmessage = (event) => {
    heard = tried = Date.now();
    for (const [id, html] of Object.entries(JSON.parse(event.data))) {
      const place = document.getElementById(id);
      if (place) place.innerHTML = html;
    }
    document.title = document.querySelector("#head h1").textContent + " · " + document.querySelector("#head p").textContent;
    show();
  };
}

function show() {
  const silent = Math.round((Date.now() - heard) / 1000);
  document.body.classList.toggle("stale", silent > period + LATE_S);
  late.textContent = "No connection. What you see is " + silent + " s old.";
}

setInterval(() => {
  show();
  if (Date.now() - tried > (period + AGAIN_S) * 1000) { // a radio that went away without a word
    events.close();
    open();
  }
}, 1000);
open();
