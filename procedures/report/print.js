// On paper every figure has the width and the type of the page; on the screen those of its column, as before.
const figures = () => document.querySelectorAll(".js-plotly-plot");
const resized = (figure, width, size, heading) => {
  const update = {autosize: width === null, width, "font.size": size};
  (figure.layout.annotations || []).forEach((_, i) => (update[`annotations[${i}].font.size`] = heading));
  Plotly.relayout(figure, update);
};
addEventListener("beforeprint", () => figures().forEach(figure => resized(figure, 680, 10.5, 11)));
addEventListener("afterprint", () => figures().forEach(figure => resized(figure, null, 13, 15)));
