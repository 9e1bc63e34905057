// Files for the visitor: the log as CSV, the scene as a picture.

function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function saveLog(history) {
  const lines = [history.layout.columns().join(",")];
  for (let i = 0; i < history.length; i++) lines.push(history.row(i).join(","));
  save(new Blob([lines.join("\n"), "\n"], { type: "text/csv" }), "cfmmr.csv");
}

// The scene has no background of its own.
function savePicture(canvas) {
  const copy = document.createElement("canvas");
  copy.width = canvas.width; copy.height = canvas.height;
  const g = copy.getContext("2d");
  g.fillStyle = color("--card"); g.fillRect(0, 0, copy.width, copy.height);
  g.drawImage(canvas, 0, 0);
  copy.toBlob((blob) => save(blob, "cfmmr.png"), "image/png");
}
