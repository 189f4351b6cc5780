"use strict";
// Only conveniences: without this script everything on the page can be read and filtered all the same.
const search = document.createElement("input");
search.type = "search";
search.placeholder = "Find a requirement or a word";
search.setAttribute("aria-label", search.placeholder);
search.addEventListener("input", () => {
  const wanted = search.value.trim().toLowerCase();
  for (const row of document.querySelectorAll(".index tbody tr"))
    row.classList.toggle("hidden", !row.textContent.toLowerCase().includes(wanted));
});
document.querySelector(".chips").append(search);
for (const line of document.querySelectorAll(".command")) {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = "Copy";
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(line.querySelector("code").textContent);
      button.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(line.querySelector("code"));
      button.textContent = "Selected";
    }
    setTimeout(() => { button.textContent = "Copy"; }, 2000);
  });
  line.append(button);
}
const reveal = () => {
  const target = document.getElementById(location.hash.slice(1));
  for (let one = target; one; one = one.parentElement) if (one.tagName === "DETAILS") one.open = true;
  target?.scrollIntoView();
};
addEventListener("hashchange", reveal);
reveal();
addEventListener("beforeprint", () => {
  for (const one of document.querySelectorAll("article.fail details, article.inconclusive details"))
    one.open = true;
});
