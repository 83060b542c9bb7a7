// Sortable tables: a button in each heading, aria-sort on the heading, rows without a value always last.
"use strict";

function sortTable(table, column, descending) {
  const body = table.tBodies[0];
  const value = row => row.cells[column].dataset.sort;
  const rows = [...body.rows].map((row, index) => ({ row, index, value: value(row) }));
  const sign = descending ? -1 : 1;
  const text = table.tHead.rows[0].cells[column].dataset.kind === "text";
  rows.sort((a, b) => {
    if (a.value === "" || b.value === "") return (a.value === "") - (b.value === "") || a.index - b.index;
    const order = text ? a.value.localeCompare(b.value, "en") : Number(a.value) - Number(b.value);
    return sign * order || a.index - b.index;
  });
  body.append(...rows.map(entry => entry.row));
  for (const heading of table.tHead.rows[0].cells) heading.removeAttribute("aria-sort");
  table.tHead.rows[0].cells[column].setAttribute("aria-sort", descending ? "descending" : "ascending");
}

for (const table of document.querySelectorAll("table.sortable")) {
  [...table.tHead.rows[0].cells].forEach((heading, column) => {
    heading.querySelector("button").addEventListener("click", () => {
      const now = heading.getAttribute("aria-sort");
      const first = heading.dataset.first === "descending";
      sortTable(table, column, now ? now === "ascending" : first);
    });
  });
}
