"""The area for dropped files, with a script that uploads, shows progress and reports errors."""

from html import escape

from nicegui import ui

from spiral.app.upload import MOST, too_large_error

READS = "CSV and other text, Parquet, MATLAB, NPZ, HDF5, UFF, TDMS, Excel"


def drop_zone(beside: str = "") -> None:
    """A file chosen or dropped here goes to ``/upload``, and the page follows it.

    ``beside`` is the setup of another file of the same machine, which this one joins.
    """
    head = "Drop a file here, or click to choose one"
    said = f"{READS}; at most {MOST / 1e9:.3g} GB. It stays on this machine."
    if beside:
        head = "Drop another file of this machine, or click to choose one"
        said = "With the same columns: the test record, or more to fit."
    ui.html(
        f'<label class="drop" id="drop" tabindex="0" data-beside="{escape(beside)}">'
        f'<input type="file" id="drop-file"><b>{head}</b>'
        f'<span>{escape(said)}</span><progress id="drop-share" max="1" '
        'value="0" hidden></progress></label>'
        '<div class="trouble" id="drop-trouble" role="alert" hidden></div>',
        sanitize=False,
    )


def drop_script() -> None:
    """The script behind ``drop_zone``: once for a page, before it is sent."""
    error = too_large_error(None).as_dict()
    ui.add_body_html(
        "<script>"
        + _SCRIPT.replace("LIMIT", str(MOST))
        .replace("EXPECTED", error["expected"])
        .replace("TRY", error["try"])
        + "</script>"
    )


_SCRIPT = r"""
(() => {
  const at = (id) => document.getElementById(id);
  const tell = (error) => {
    const box = at("drop-trouble"); box.hidden = false; box.textContent = "";
    at("drop-share").hidden = true; at("drop").classList.remove("over");
    const first = document.createElement("b"); first.textContent = error.given; box.append(first);
    for (const [name, text] of [["Expected", error.expected], ["Try", error.try]])
      if (text) box.append(document.createElement("br"), `${name}: ${text}`);
    box.scrollIntoView({block: "nearest"});
  };
  const send = (file) => {
    at("drop-trouble").hidden = true;
    if (file.size > LIMIT)
      return tell({given: `${file.name}: a file of ${(file.size / 1e9).toPrecision(3)} GB`,
                   expected: "EXPECTED", try: "TRY"});
    if (!file.size)
      return tell({given: `${file.name}: an empty file`, expected: "rows of numbers",
                   try: "export it again"});
    const request = new XMLHttpRequest(), share = at("drop-share");
    share.hidden = false; share.value = 0;
    request.upload.onprogress = (e) => { if (e.total) share.value = e.loaded / e.total; };
    request.onload = () => {
      let answer = {};
      try { answer = JSON.parse(request.responseText); } catch { answer = {}; }
      if (answer.page && location.pathname === answer.page) share.hidden = true;
      else if (answer.page) location.href = answer.page;
      else tell(answer.error || {given: `the file was refused (${request.status})`,
                                 expected: "a file of measurements", try: "another file"});
    };
    request.onerror = () => tell({given: "the upload broke off", expected: "the whole file",
                                  try: "drop it again; is the program still running?"});
    request.open("POST", "/upload");
    request.setRequestHeader("x-file-name", encodeURIComponent(file.name));
    request.setRequestHeader("x-file-beside", at("drop").dataset.beside);
    request.send(file);
  };
  const inside = (e) => e.target.closest && e.target.closest("#drop");
  document.addEventListener("change", (e) => {
    if (e.target.id === "drop-file" && e.target.files.length) {
      send(e.target.files[0]); e.target.value = "";
    }
  });
  document.addEventListener("dragover", (e) => {
    e.preventDefault(); const zone = at("drop");
    if (zone) zone.classList.toggle("over", Boolean(inside(e)));
  });
  document.addEventListener("drop", (e) => {
    e.preventDefault(); const zone = at("drop");
    if (zone) zone.classList.remove("over");
    if (inside(e) && e.dataTransfer.files.length) send(e.dataTransfer.files[0]);
  });
  document.addEventListener("keydown", (e) => {
    if ((e.key === "Enter" || e.key === " ") && e.target.id === "drop") at("drop-file").click();
  });
})();
"""
