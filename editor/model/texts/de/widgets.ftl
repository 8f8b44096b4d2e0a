# Was beide Fenster gleich zeichnen.

## Das Formular für Argumente

form-cancel = Abbrechen
form-unchanged = Die Graphdatei wird nicht geändert.
form-overlays = Quelle der Bilder
form-own = wie im Graphen
form-overlay = Overlay { $name }
form-default = Vorgabe
form-default-is = Vorgabe: { $value }
form-required = nötig
form-not-used = nicht verwendet
form-range = { $low } bis { $high }
form-clear = leeren
    .name = { $argument } leeren
    .hint = Entfernt den Wert, sodass die Vorgabe gilt
form-argument = Argument { $argument }
form-cameras = Kameras
    .name = Kameras für { $argument }
form-browse = Suchen
    .name = Datei für { $argument } suchen
