"use strict";
{
  const cards = document.getElementById("cards");
  const all = [...cards.children];
  const [state, sort, down, search, count] = ["state", "sort", "down", "search", "count"].map((id) => document.getElementById(id));

  function show() {
    const name = sort.value.toLowerCase();
    const words = search.value.toLowerCase();
    const value = (card) => (name in card.dataset ? Number(card.dataset[name]) : NaN);
    const sign = down.checked ? -1 : 1;
    const order = all.map((card, k) => [card, k, value(card)]);
    order.sort(([, i, a], [, j, b]) => {
      if (Number.isNaN(a) || Number.isNaN(b)) return Number.isNaN(a) - Number.isNaN(b) || i - j;
      return sign * (a - b) || i - j;
    });
    if (!name && down.checked) order.reverse();
    let shown = 0;
    for (const [card] of order) {
      const wanted = state.value === "" || card.dataset.state === state.value;
      card.hidden = !wanted || (words !== "" && !card.textContent.toLowerCase().includes(words));
      shown += !card.hidden;
    }
    cards.append(...order.map(([card]) => card));
    count.textContent = `${shown} shown`;
  }

  for (const control of [state, sort, down, search]) control.addEventListener("input", show);
  document.querySelector("form").addEventListener("submit", (event) => event.preventDefault());
  show();
}
