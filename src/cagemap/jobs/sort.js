// Sort the table by a column: numbers as numbers, empty cells last; a second click turns the order round.
const body = document.querySelector(".library tbody");
document.querySelectorAll(".library th").forEach((head, column) => {
  if (column === 0) return;
  head.addEventListener("click", () => {
    const down = head.classList.contains("up");
    document.querySelectorAll(".library th").forEach(other => other.classList.remove("up", "down"));
    head.classList.add(down ? "down" : "up");
    const key = row => row.children[column].dataset.value ?? "";
    const rows = [...body.rows].sort((a, b) => {
      const x = key(a), y = key(b);
      if (x === "" || y === "") return (x === "") - (y === "");
      const order = isNaN(x) || isNaN(y) ? x.localeCompare(y) : x - y;
      return down ? -order : order;
    });
    body.append(...rows);
  });
});
