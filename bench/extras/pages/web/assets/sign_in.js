// Sign-in: the token goes to the server once, in the body of a request. It may come as #token=... in the address; that
// part never leaves the browser. It is removed from the address line, but the browser's history keeps it.
import { post, setText } from "/assets/bench.js";

const form = document.getElementById("form"), field = document.getElementById("token"), wrong = document.getElementById("wrong");

function nextPage() {
  // A browser reads "/\t/host" and "/\host" as another host, so its own reading decides.
  const next = new URL(new URLSearchParams(location.search).get("next") || "/", location.origin);
  return next.origin === location.origin ? next.pathname + next.search : "/";
}

async function signIn(token) {
  setText(wrong, "");
  try {
    await post("/sign-in", { token });
    location.replace(nextPage());
  } catch (error) {
    setText(wrong, error.message);
    field.focus();
  }
}

form.addEventListener("submit", (event) => { event.preventDefault(); signIn(field.value.trim()); });
const given = new URLSearchParams(location.hash.slice(1)).get("token");
history.replaceState(null, "", location.pathname + location.search);
if (given) signIn(given);
else field.focus();
