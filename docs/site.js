// What scrolls sideways can be reached, and scrolled, by the keyboard.
function reachable() {
  for (const element of document.querySelectorAll(".md-typeset pre > code, .md-typeset__scrollwrap"))
    if (element.scrollWidth > element.clientWidth) element.tabIndex = 0;
}
addEventListener("load", () => {
  reachable();
  new ResizeObserver(reachable).observe(document.body);
});
