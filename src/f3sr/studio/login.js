// Asks for the password; the right one leads to an address of its own.
(() => {
  "use strict";
  const line = document.getElementById("line"), field = document.getElementById("password");
  document.getElementById("form").addEventListener("submit", async (e) => {
    e.preventDefault();
    line.textContent = "";
    try {
      const answer = await fetch("/login", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ password: field.value }) });
      if (answer.ok) return void location.replace((await answer.json()).address);
      line.textContent = answer.status === 403 ? "That is another password." : (await answer.text()).trim();
    } catch {
      line.textContent = "The studio does not answer.";
    }
    field.select();
  });
})();
