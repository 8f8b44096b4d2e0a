# Die Felder des Editors um den Graphen.

## Durchfahren eines Parameters

sweep-parameter = Parameter
    .filter = Parameter filtern
    .name = Durchfahrener Parameter
sweep-range = von, bis
    .from = Durchfahren von
    .to = Durchfahren bis
sweep-steps = Schritte
    .suffix = Schritte
sweep-measure = Maß
    .name = Gemessenes Maß
sweep-measures = wählen
    .filter = Messgrößen filtern
    .name = Bekannte Maße
sweep-pictures = Bilder
    .hint = die eigenen Quellen des Graphen
    .name = Aufzeichnung, die verwendet wird
    .file = Datei
    .file-hint = Eine Aufzeichnung (.mcap) anstelle der Quellen des Graphen
sweep-frames = je Wert
    .name = Bilder je Wert
    .suffix = Bilder
sweep-cancel = Abbrechen
    .hint = Die bisher gemessenen Werte bleiben
sweep-start = Durchfahren
    .hint = Läuft neben dem Graphen im Stapelbetrieb, ohne Knoten mit Nebenwirkungen
sweep-lacks-graph = Der Graph hat Fehler: nur ein gültiger Graph wird durchfahren.
sweep-lacks-parameter = Der Graph hat keinen Parameter, der sich durchfahren lässt.
sweep-lacks-measure = Eine Messgröße wählen: einen Skalar, eine Tabellenspalte, eine Metrik oder eine Zeit.
sweep-about = Lässt den Graphen für jeden Wert einmal über dieselben Bilder laufen. Der Graph in diesem Fenster läuft weiter.
sweep-title = { $measure } über { $param }
sweep-not-started = nicht gestartet
sweep-preparing = wird vorbereitet
sweep-cancelled = abgebrochen nach { $count } von { $total }
sweep-done = { $count } von { $total } Werten
sweep-progress = { $count } von { $total }
sweep-failed = bei { $value }: { $reason }
sweep-ends = kleinster bis größter
sweep-mean = Mittel
sweep-name = Durchfahren: { $values }
sweep-no-thread = es konnte kein Thread gestartet werden: { $reason }
export-png-hint = Schreibt ein Bild der Kurve nach out/
export-csv-hint = Schreibt alle Werte nach out/
export-curves-hint = Schreibt alle Punkte der Kurven nach out/

## Presets und Schnappschüsse

presets-heading = Presets
    .hint = Name der jetzigen Werte
    .name = Name des Presets
    .store = Preset speichern
    .none = Noch keine Presets: jedes hält die Werte aller Knoten fest.
preset-apply = Preset { $name } anwenden
preset-remove = Preset { $name } entfernen
state-remove = entfernen
morph-name = Überblenden
    .from = Überblenden von
    .to = Überblenden nach
snapshots-heading = Schnappschüsse
    .take = Schnappschuss machen
    .none = Noch keine Schnappschüsse: jeder hält den ganzen Graphen fest, um zu ihm zurückzukehren.
snapshot-restore = Zurück zu Schnappschuss { $number }
snapshot-remove = Schnappschuss { $number } entfernen
snapshot-blank = { $number }: kein Bild
age-now = gerade eben
age-minutes = vor { $count } min
age-hours = vor { $count } h
age-days = vor { $count } d

## Aufzeichnungen

timeline-about = Eine Aufzeichnung zeigt ihre Bilder an den Knoten; der Graph läuft weiter. Aufzeichnen hält jeden Ausgang fest, von einem neuen Start des Graphen an.
timeline-file = Aufzeichnung
    .open = Aufzeichnung öffnen
    .browse = Aufzeichnungen auflisten
timeline-title = Bilder der Aufzeichnung { $file }
    .hint = Der Graph läuft weiter; seine eigenen Bilder kommen wieder, wenn die Aufzeichnung geschlossen wird
timeline-close = Aufzeichnung schließen
timeline-back = Schritt zurück
timeline-forward = Schritt vor
timeline-play = Abspielen
timeline-pause = Anhalten
timeline-speed = Geschwindigkeit
timeline-loop-from = Schleife ab hier
timeline-loop-to = Schleife bis hier
timeline-loop-end = Schleife beenden
timeline-range = { $from } bis { $to } s
timeline-moment = Zeitpunkt der Aufzeichnung
timeline-at = { $at } von { $length } s  ·  Takt { $tick } von { $count }
timeline-at-name = Aufzeichnung bei { $moment }
timeline-compute = Übrige Knoten neu berechnen
    .hint = Der Graph hat sich geändert, seit seine Ausgaben berechnet wurden
    .failed = Die übrigen Knoten ließen sich nicht berechnen: { $reason }
timeline-beside = Daneben: { $file }; V zeigt eine Ausgabe groß, C vergleicht sie mit der des zweiten Laufs.
timeline-compare-end = Vergleich beenden
timeline-second = Zweite Aufzeichnung
    .open = Damit vergleichen
    .browse = Aufzeichnungen für die zweite auflisten
record-start = Aufzeichnen
record-stop = Aufzeichnung beenden und zeigen
record-runs = Wird aufgezeichnet: { $file }
record-begins = der Graph beginnt von vorn und wird aufgezeichnet: { $file }
record-done = { $count ->
    [one] 1 Takt aufgezeichnet
   *[other] { $count } Takte aufgezeichnet
}: { $file }
record-failed = { $file } endete vorzeitig: { $reason }

## Takte

trace-heading = Verlorene und späte Takte
    .none = Noch ist kein Takt durchgelaufen.
trace-elsewhere = Der Graph läuft auf { $machine }, von dort kommen keine Wege von Takten: dort öffnen, um sie zu sehen. Die Zahl verlorener Takte und die Zeiten der Knoten stehen auch hier.
trace-path = Weg
    .about = Einen Takt wählen: sein Weg durch den Graphen mit der Zeit jedes Knotens und seinem Warten.
trace-dropped = Takt { $tick } von { $source } ging verloren: { $behind } war noch bei { $nodes }
trace-on-its-way = unterwegs
trace-late = Takt { $tick } von { $source }: { $time }
trace-in-the-way = Takt { $tick } von { $source }, der Takt { $dropped } im Weg war
trace-path-of = Weg von Takt { $tick } von { $source }
trace-path-name = { $heading }: { $longest }
trace-no-output = keine Ausgabe
trace-waited = { $work }, wartete { $time }
trace-waited-after = { $work }, wartete { $time } nach { $node }
trace-step = Schritt { $node }: { $found }

## Verlauf der Werte

history-back = Zurück
history-forward = Vor
history-empty = leer
history-default = Vorgabe
history-default-is = { $value } (Vorgabe)
history-count = { $count ->
    [0] Noch kein Wert wurde geändert.
    [one] 1 Änderung
   *[other] { $count } Änderungen
}
history-applied = { $at } von { $count } Änderungen sind angewendet
history-tick = Takt { $tick }
history-waits = wartet
history-restore = Stellt die Werte nach dieser Änderung wieder her
history-change = Änderung { $number }: { $param } von { $from } auf { $to }
history-from-to = { $from }  auf  { $to }

## Das Feld eines Knotens

node-inputs = Eingänge
node-outputs = Ausgänge
node-parameters = Parameter
node-sweep = einen über einen Bereich durchfahren
    .name = Parameter durchfahren
node-none = Einen Knoten wählen, um zu sehen, was er liest, seine Werte und Zeiten.
node-name = Name
    .hint = Name; Eingabe benennt den Knoten überall um
node-unknown = { $type } · nicht bekannt
node-help = Hilfe
    .name = Hilfe zum Knoten
node-source = Quelltext
    .name = Quelltext des Knotens
part-open = Öffnen
part-dissolve = Auflösen
part-users = { $count }-mal verwendet
node-picture = { $output } groß zeigen
    .hint = Klicken, um es im Betrachter zu öffnen (V)
    .probe = für einen Wert auf das Bild zeigen
node-output = Gezeigte Ausgabe
node-idle = Warum er ruht
go-to = Zu { $node }
node-rate = Rate
node-rate-is = { $rate } fps
node-time = Zeit
node-age = Alter
node-median = { $median }  ·  p99 { $slow }
node-ticks = Takte
node-copies = Kopien
node-ticks-are = { $count }  ·  { $dropped } verloren
node-trace = warum Takte verloren gehen
    .name = Warum Takte verloren gehen
node-fault = Letzte Störung
    .seen = Zur Kenntnis nehmen
node-fault-is = { $cause }, bisher { $count }; danach: { $done }
node-input = Eingang { $input }
node-not-connected = nicht verbunden

## Parameter

param-reopens = Eine Änderung öffnet den Knoten neu.
param-differs = { $param } weicht von der Datei ab
    .hint = Weicht von der Datei ab
param-reset = zurücksetzen
    .name = { $param } zurücksetzen
    .hint = Entfernt ihn aus der Datei, sodass die Vorgabe gilt
param-pick = im Bild
    .name = { $param } im Bild wählen
    .points = Im Bild: klicken fügt hinzu, ziehen bewegt
    .rectangles = Im Bild: ziehen zeichnet, die Griffe ändern
param-browse = suchen
    .name = { $param } suchen
    .hint = Dateien und Ordner
param-value = { $param } Wert

## Hilfe zu einem Knoten

help-of = Hilfe zu { $type }
help-about = { $family } · Plugin { $plugin }
help-source = erzeugt eigene Takte
help-device = besitzt ein Gerät
help-acts = wirkt über den Graphen hinaus
help-examples = Beispielgraphen
    .none = Kein Graph neben diesem oder in der Installation verwendet ihn.
help-open = Beispiel { $name } öffnen
help-limits = Grenzen von { $param }: { $limits }
help-list = Liste von { $packet }
help-optional = { $packet }, optional
limits-range = { $low } bis { $high }
limits-from = ab { $low }
limits-to = bis { $high }
limits-switch = an oder aus
limits-whole = eine ganze Zahl
limits-number = eine Zahl
limits-steps = { $range } in Schritten von { $step }
limits-text = ein Text
limits-file = eine vorhandene Datei
limits-path = ein Pfad
limits-numbers = { $count } Zahlen
limits-numbers-range = { $low } bis { $high } Zahlen
limits-any-numbers = Zahlen
limits-default = { $limits }; Vorgabe { $value }
limits-default-reopens = { $limits }; Vorgabe { $value }; eine Änderung öffnet den Knoten neu
value-on = an
value-off = aus
value-empty = leer

## Das Feld des Graphen

overview-selected = { $count } Knoten gewählt
overview-make-part = Teil daraus machen
overview-preset = Preset
overview-copy = kopieren
    .name = { $command } kopieren
overview-more = mehr
overview-less = weniger
overview-time = Wohin die Zeit geht
overview-nothing = nichts läuft
overview-share = { $time }   { $percent } %

## Kurven

plot-times = Mittlere Zeit
    .axis = ms je Aufruf
plot-slowest = 99-%-Zeit
plot-rate = Rate
    .axis = Aufrufe je Sekunde
plot-queues = Warteschlangen
    .axis = wartende Pakete
    .none = alle Warteschlangen sind leer: jeder Knoten hält mit
plot-scatter = Eins über anderem
plot-histogram = Histogramm über die Zeit
plot-x = Waagrecht
plot-y = Senkrecht
plot-scatter-about = { $count } Paare  ·  Korrelation { $correlation }
plot-scatter-count = { $count } Paare
plot-histogram-about = Mittel { $mean }  ·  Standardabweichung { $deviation }
plot-values = Werte
    .axis = Wert
    .none = noch kein Wert und keine Tabelle empfangen
plot-name = Zeiten

## Fehler und Störungen, Text

mistakes-change = Änderung nicht übernommen
mistakes-none = Die Datei hat keine Fehler.
mistakes-faults = Störungen, neueste zuerst
mistakes-at = { $seconds } s  { $node }
text-name = Text der Datei

## Quelltext eines Knotens

source-save = Speichern und einwechseln
    .hint = Strg+Eingabe
source-close = Quelltext schließen
source-changed = geändert
source-name = Quelltext
source-unreadable = { $file } kann nicht gelesen werden: { $reason }
source-too-long = { $file } hat mehr als 1 MiB
source-replaced = { $file } wurde von einem anderen Programm geändert: Quelltext schließen und neu öffnen

## Plugins

plugins-heading = Plugins
    .reload = Neu laden
    .hint = Wechselt neu gebaute Plugins in den laufenden Graphen ein
plugins-nodes = Knoten: { $nodes }

## Dateien

files-unreadable = { $folder } kann nicht gelesen werden: { $reason }
files-up = Nach oben
    .hint = Übergeordneter Ordner (Rücktaste)
files-name = Dateiname
    .hint = Einen Teil des Namens oder einen neuen Namen tippen
files-empty = der Ordner ist leer
files-new = keine Datei heißt so; Eingabe verwendet den Namen für eine neue
files-file = Datei { $name }
files-folder = Ordner { $name }

overview-ages = Alter am Ende jedes Weges
overview-age = { $median }   p99 { $slow }
go-to-end = Zum Ende { $node }
