// Figures of the notebooks are drawn by the site's own copy of Plotly, each when it comes into sight.
(() => {
  const figures = document.querySelectorAll("script[data-figure]");
  if (!figures.length) return;
  const draw = (script) => {
    const { data, layout } = JSON.parse(script.textContent);
    const place = document.getElementById(script.dataset.figure);
    Plotly.newPlot(place, data, { ...layout, autosize: true }, { responsive: true, displaylogo: false });
  };
  const plotly = document.createElement("script");
  plotly.src = new URL("plotly.min.js", document.querySelector("script[src*='assets/figures.js']").src);
  plotly.onload = () => {
    const seen = new IntersectionObserver((entries) => {
      for (const entry of entries.filter((e) => e.isIntersecting)) {
        seen.unobserve(entry.target);
        draw(document.querySelector(`script[data-figure="${entry.target.id}"]`));
      }
    }, { rootMargin: "400px" });
    figures.forEach((script) => seen.observe(document.getElementById(script.dataset.figure)));
  };
  document.head.appendChild(plotly);
})();
