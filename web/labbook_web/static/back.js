// Steps back and forth through a page that has just been loaded again: until htmx listens, they would change the address alone.
"use strict";
addEventListener("popstate", (event) => {
  if (event.state && event.state.htmx && !window.onpopstate) location.reload();
});
