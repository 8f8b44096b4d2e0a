# Das Fenster des Editors: Leisten, Rundgänge, Dialoge, die Fläche, der Betrachter.

## Die Leiste oben

top-changed = geändert
    .hint = Es gibt ungespeicherte Änderungen
top-keys = Tasten
top-sweep = Reihe
top-presets = Presets
top-history = Verlauf
top-plots = Kurven
top-text = Text
top-heat = Auslastung
top-problems = Probleme
    .count = Probleme { $count }
top-arguments = Argumente
    .count = Argumente { $count }
top-fit = Einpassen
top-find = Suchen
top-add = Hinzufügen
top-save = Speichern
top-redo = Wiederholen
top-undo = Rückgängig
top-again = Neu starten
top-record = Aufzeichnen
    .stop = Aufzeichnung beenden
top-play = Abspielen
    .pause = Anhalten
top-step = Schritt
top-loop = Schleife
top-speed = { $speed }-fach
top-look = Ansicht
top-run = Lauf
top-menu = Weitere Knöpfe, weil das Fenster schmal ist
state-unfinished = { $count ->
    [0] noch nicht fertig: ein Knoten hat nichts zu lesen
    [one] noch nicht fertig: 1 Eingang ist nicht verbunden
   *[other] noch nicht fertig: { $count } Eingänge sind nicht verbunden
}
state-unfinished-runs = { $count ->
    [0] noch nicht fertig; der letzte gültige Graph läuft weiter
    [one] noch nicht fertig: 1 Eingang ist nicht verbunden; der letzte gültige Graph läuft weiter
   *[other] noch nicht fertig: { $count } Eingänge sind nicht verbunden; der letzte gültige Graph läuft weiter
}
state-recorded = zeigt die Aufzeichnung { $file }; der Graph läuft weiter
state-over = { $count ->
    [one] 1 Bild
   *[other] { $count } Bilder
} in { $seconds } s, { $rate } Bilder/s
state-name = Zustand: { $state }
state-disk-full = Datenträger voll: „{ $node }“ schreibt nicht mehr
state-bypassed = „{ $node }“ ist nach einer Störung überbrückt
state-not-started = nicht gestartet
state-no-nodes = noch keine Knoten: A fügt einen hinzu
state-lacks = braucht einen Wert für { $arguments }
state-mistakes = die Datei hat Fehler
state-is-starting = startet
state-change-failed = die Änderung misslang; der alte Graph läuft weiter
state-last-valid = die Datei hat Fehler; der letzte gültige Graph läuft weiter
state-running = läuft
state-ended = der Lauf ist zu Ende, seine Dateien sind fertig
state-rate = { $rate } fps
state-age = Alter p99 { $age }
state-drops = { $count ->
    [one] 1 verloren
   *[other] { $count } verloren
}

## Der Rundgang beim ersten Start

guide-runs = Es läuft schon
    .words = Jeder Kasten ist ein Knoten des Graphen, mit einem lebenden Bild dessen, was er macht, seiner Zeit und seiner Rate.
guide-look = Einen Knoten ansehen
    .words = Einen Knoten anklicken. Das Feld rechts zeigt, was er liest, seine Werte und seine Zeiten. { $help } zeigt seine Hilfe.
guide-change = Einen Wert ändern
    .words = Einen Regler bewegen: der Wert gilt ab dem nächsten Bild, und kein Bild geht verloren. { $undo } nimmt es zurück.
guide-closely = Genau hinsehen
    .words = { $view } öffnet das Bild groß: darauf zeigen für Werte, eine Linie ziehen für ein Profil, { $compare } vergleicht es mit einem anderen.
guide-wire = Im Lauf verdrahten
    .words = { $add } fügt einen Knoten hinzu, Ziehen von Anschluss zu Anschluss verbindet ihn. Was nicht passt, wird mit Grund abgelehnt.
guide-find = Alles finden
    .words = { $commands } findet jeden Befehl, Knoten und Wert. { $problem } führt durch Probleme, { $help } listet die Tasten. { $save } speichert.
guide-name = Rundgang { $at } von { $count }: { $heading }
guide-next = Weiter
guide-skip = Rundgang überspringen
guide-not-kept = { $folder } kann nicht geschrieben werden: der Rundgang kommt wieder

## Der Rundgang durch Probleme

tour-nothing = alles in Ordnung: keine Fehler, Störungen, ruhenden Knoten oder verlorenen Takte
tour-heading = { $at } von { $count }  ·  { $place }
tour-name = Problem { $heading }
tour-remedy = Was zu tun ist: { $remedy }
tour-previous = Voriges Problem
tour-next = Nächstes Problem
tour-end = Rundgang beenden

## Hilfe und Quelltext von Knoten

learn-select = für die Hilfe einen Knoten bekannten Typs wählen
learn-opens = { $file } öffnet sich in einem eigenen Fenster
learn-not-opened = { $file } konnte nicht geöffnet werden: { $reason }
learn-source-elsewhere = der Quelltext der Knoten ist auf „{ $machine }“, wo der Graph läuft: dort ändern
learn-no-source = für den Quelltext einen Knoten wählen, der in Python geschrieben ist
learn-source-swapped = { $file } ist gespeichert und eingewechselt
learn-source-unsaved = der Quelltext ist nicht gespeichert: noch einmal schließen, um die Änderungen zu verwerfen

## Dateien, Konflikte, andere Rechner

save-refused = nicht gespeichert: die Datei wurde auch auf dem Datenträger geändert; oben in der Leiste wählen, welcher Text bleibt
save-reloaded = die Datei wurde auf dem Datenträger geändert und neu geladen; Zurücknehmen stellt den alten Text her
save-reloaded-file = { $file } wurde auf dem Datenträger geändert und neu geladen; Zurücknehmen stellt den alten Text her
save-copy = als Kopie gespeichert, weil das Original zur Installation gehört: { $file }
save-failed = { $file } wurde nicht gespeichert: { $reason }
save-done = { $count ->
    [one] gespeichert
   *[other] { $count } Dateien gespeichert
}
conflict-machine = Der Graph wurde auf seinem Rechner und auch in diesem Fenster geändert. Welcher Text bleibt?
conflict-file = Die Datei wurde auf dem Datenträger geändert, und auch der Graph in diesem Fenster. Welcher Text bleibt?
conflict-part = { $file } wurde auf dem Datenträger und auch in diesem Fenster geändert. Welcher Text bleibt?
conflict-unsaved = Nicht gespeichert.
conflict-theirs = Den der Datei nehmen
    .hint = Zurücknehmen stellt den Graphen dieses Fensters wieder her
conflict-ours = Diesen behalten
    .hint = Das nächste Speichern ersetzt die Datei und behält ihren Text als Sicherung
conflict-kept = behalten; das nächste Speichern ersetzt die Datei und behält ihren Text als Sicherung
conflict-equal = { $count } gleiche Zeilen
conflict-more = { $count } weitere Zeilen
conflict-difference = Unterschied: { $ours } in diesem Fenster (-), { $theirs } in der Datei (+)
    .name = Text des Unterschieds
machine-read-only = „{ $machine }“ lässt dieses Fenster nur lesen; nichts wurde geändert
machine-changed = der Graph von „{ $machine }“ wurde geändert von { $who }
    .there = dort
machine-copy = eine Kopie ist hier gespeichert: { $file }
machine-unreached = { $machine } ist nicht erreichbar: { $reason }
machine-lost = { $machine } ist seit { $seconds } s nicht erreichbar: { $reason }; die Bilder sind alt, neue Versuche laufen
machine-ended = { $machine }: { $reason }
machine-edits = dieses Fenster ändert ihn
machine-reads = dieses Fenster liest nur
machine-runs = Läuft auf { $machine }: { $may }. Kein Not-Halt von hier
machine-runs-clock = Läuft auf { $machine }: { $may }, Alter auf { $error } ms genau (Uhr { $offset } ms, hin und zurück in { $reach } ms). Kein Not-Halt von hier

## Neue Graphen, Argumente, Teile

new-heading = Ein neuer Graph
new-written = { $file } wird beim Speichern geschrieben
new-template = Vorlage { $name }
template-cameras = Zwei Kameras
    .about = Zwei Kameras, Videos oder Bilder nebeneinander.
template-panorama = Panorama
    .about = Aus zwei berechneten Ansichten wird ein breites Bild.
template-depth = Tiefe
    .about = Aus zwei berechneten Ansichten wird eine Oberfläche in mm.
template-empty = Leer
    .about = Ein leerer Graph; A fügt Knoten hinzu.
new-drop = eine Datei ablegen oder eine für jede der beiden Seiten
new-unknown = { $file } ist kein Graph, Bild oder Video
args-none = der Graph hat keine Argumente, und kein Overlay passt zu ihm
args-heading = Argumente von { $graph }
args-starts = Der Graph läuft, sobald er hat, was er braucht. Dateien können hier abgelegt werden.
args-applies = Die Werte gelten für den laufenden Graphen.
args-start = Start
args-apply = Übernehmen
args-not-kept = die Werte wurden nicht gemerkt: { $reason }
args-no-place = kein Argument ohne Wert nimmt { $file }
part-select-open = ein Teil wählen, um es zu öffnen
part-select-nodes = zuerst die Knoten des Teils wählen
part-select-dissolve = ein Teil wählen, um es aufzulösen
part-dissolved = { $part } ist aufgelöst; seine Datei bleibt, wie sie ist
part-heading = Ein Teil aus { $count } Knoten
part-name = Name des Teils
    .hint = Name
part-writes = Beim Speichern wird { $file } geschrieben
part-make = Teil machen
part-cancel = Abbrechen
part-used = { $part } wird in diesem Graphen { $count }-mal verwendet
part-applies = Die Änderung gilt für jedes davon: { $users }.
part-others = Andere Graphen mit dieser Datei ändern sich auch. Beim Speichern wird sie geschrieben.
part-change-all = Alle { $count } ändern

## Was geschah

done-undone = zurückgenommen: { $step }
done-redone = wiederholt: { $step }
done-bypassed = { $node } ist überbrückt
done-preset = gespeichert: Preset { $name }
done-snapshot = Schnappschuss { $number } ist gemacht
done-restored = der Graph ist wie in Schnappschuss { $number }; Strg+Z geht zurück
done-restored-already = der Graph ist schon wie in Schnappschuss { $number }
done-left-out = { $step }: ausgelassen { $first }
done-left-out-more = { $step }: ausgelassen { $first } und { $count } weitere
done-written = geschrieben: { $file }
done-not-written = die Kurven wurden nicht geschrieben: { $reason }
done-newest = dies ist der neueste Wert im Verlauf
done-oldest = dies ist der älteste Wert im Verlauf
done-connected = verbunden: { $wires }
done-arranged = { $count ->
    [one] 1 Knoten ist geordnet
   *[other] { $count } Knoten sind geordnet
}
done-arranged-already = alle Knoten sind schon geordnet
need-own-machine = der Graph läuft auf einer anderen Maschine: dort aufzeichnen
need-valid = der Graph hat Fehler: nur ein laufender Graph wird aufgezeichnet
done-acknowledged = { $count ->
    [0] es gibt keine Störung
    [one] 1 Störung ist zur Kenntnis genommen
   *[other] { $count } Störungen sind zur Kenntnis genommen
}
need-two-nodes = zum Ausrichten mindestens zwei Knoten wählen
need-recording = nichts abzuspielen: keine Quelle liest Dateien, und keine Aufzeichnung ist offen (J zeigt die Zeitleiste)
need-recorded-graph = kein Knoten dieses Graphen ist in der Aufzeichnung: den aufgezeichneten Graphen öffnen
need-one-node = zum Verbinden einen Knoten wählen
need-image = { $node } hat noch keinen Bildeingang: einen verbinden, dann wählen
layout-unused = { $reason }; die Felder sind wie am Anfang angeordnet

## Die Befehlssuche

palette-name = Suche
palette-add = Knoten hinzufügen: Typ, Familie oder was er tut
palette-add-to-wire = Knoten für diese Leitung hinzufügen
palette-connect = Verbinden: Name eines Eingangs oder Ausgangs
palette-find = Knoten suchen
palette-command = Ein Befehl, ein Knoten oder ein Parameter des Graphen
palette-loading = Plugins werden geladen
palette-no-match = nichts gefunden
palette-from = { $input } von { $output }
palette-part = Teil
palette-by-name = { $ports } nach Namen verbinden
palette-to = { $ports } mit { $node } verbinden
# Gruppen von Wörtern mit einer Bedeutung, durch Semikolon getrennt, klein geschrieben. Namen von Knoten sind englisch.
palette-synonyms = kamera camera capture webcam live quelle source; datei file video aufnahme recording film abspielen play; speichern schreiben aufzeichnen save write record store export; panorama zusammensetzen mosaik stitch mosaic wide composite; tiefe abstand depth disparity distance stereo; oberfläche punkte surface cloud points 3d mesh; instrument werkzeug tool detect boxes yolo; maske mask segment instances; zeigen anzeige ansicht show display preview view; glätten weichzeichnen rauschen smooth blur denoise filter; ausrichten register align match homography; entzerren kalibrieren kalibrierung rectify calibrate calibration lens; roboter arm gelenk robot joint kinematics; farbe colour color palette colorize; zuschneiden ausschnitt crop cut region roi; größe skalieren scale resize shrink; ordnen anordnen arrange order layout; rückgängig undo revert
palette-pick = { $name } wählen

## Werte von Bildern

probe-at = Wert bei { $found }
probe-range = { $low } bis { $high }
probe-mean = { $low } bis { $high }, Mittel { $mean }
probe-unknown = { $percent } % unbekannt
probe-thinned = unterwegs ausgedünnt
probe-histogram = Histogramm: { $found }
probe-profile = Profil über { $length } px: { $found }
probe-nothing = nichts bekannt

## Der Betrachter

viewer-name = Betrachter von { $output }
viewer-nothing = noch nichts
viewer-stale = kein neues Paket seit { $seconds } s
viewer-beside = Nebeneinander
viewer-numbers-none = noch kein Takt beider Ausgaben
viewer-numbers-unlike = die Ausgaben haben verschiedene Typen oder Größen
viewer-numbers-images = PSNR { $psnr } dB  ·  SSIM { $ssim }  ·  Takt { $tick }
viewer-numbers-maps = Endpunktfehler { $mean } { $unit }, 95 % unter { $p95 } { $unit }  ·  { $density } % bekannt  ·  Takt { $tick }
viewer-numbers-about = Aus den ganzen Paketen eines Takts, verglichen mit { $output }. PSNR und SSIM gelten für die Helligkeit, ohne einen Unterschied der Verstärkung; der Endpunktfehler ist der mittlere Unterschied, wo beide bekannt sind.
viewer-difference-is = mittlerer Unterschied { $mean } von 255, vierfach verstärkt
viewer-close = Schließen
viewer-surface = Oberfläche
    .hint = Wechselt zwischen Oberfläche und Kamerabild
viewer-difference = Unterschied
viewer-blink = Blinken
viewer-wipe = Teilen
viewer-with-nothing = mit nichts
viewer-compare = vergleichen
    .name = Vergleichen mit
key-escape = Esc
surface-name = Oberfläche von { $output }
surface-no-points = die Punktwolke hat keine Punkte im gewählten Tiefenbereich
surface-foot = { $node } (Fuß)
surface-measure = Messen
    .hint = Abstand zweier Punkte in mm: anklicken oder mit Pfeiltasten und Eingabe wählen
surface-measuring = Messen: zwei Punkte anklicken
surface-drifted = Kein Abstand: die Kalibrierung passt nicht mehr
surface-depth-from = Tiefe von
    .name = Kleinste gezeigte Tiefe
surface-depth-to = bis
    .name = Größte gezeigte Tiefe

## Punkte und Rechtecke auf einem Bild

pick-here = { $param } hier wählen
pick-point = Punkt { $number } von { $param }
pick-rectangle = Rechteck { $number } von { $param }
pick-corner = Rechteck { $number } Ecke { $corner } von { $param }
pick-add-point = Punkt hinzufügen
pick-add-rectangle = Rechteck hinzufügen
pick-add-hint = In der Mitte des Bildes; Pfeiltasten bewegen um 1 px, mit Umschalt um 10 px
pick-remove = Entfernen
    .hint = Das zuletzt berührte (Entf)
pick-clear = Leeren
pick-done = Fertig
pick-points-hint = klicken fügt hinzu, ziehen bewegt
pick-rectangles-hint = ziehen zeichnet, Griffe ändern

## Die Fläche

canvas-name = Graph
canvas-map = Karte des Graphen
canvas-node = Knoten { $node }
canvas-part = Teil { $part }
canvas-open = öffnen
    .name = { $node } öffnen
canvas-fold = schließen
    .name = { $part } schließen
canvas-all-ports = Alle Anschlüsse von { $node }
canvas-more = { $count } weitere
canvas-fewer = weniger
canvas-input = Eingang { $port }
canvas-output = Ausgang { $port }
canvas-old = { $seconds } s alt
canvas-age = Alter { $age }
canvas-rate = { $rate } fps
canvas-median = { $median } · p99 { $slow }
canvas-unfinished = noch nicht fertig
canvas-mistake = Fehler
canvas-recorded = aufgezeichnet
canvas-computed = aus der Aufzeichnung berechnet
canvas-computing = wird berechnet: { $percent } %
canvas-not-recorded = nicht in der Aufzeichnung
canvas-ticks = { $count ->
    [one] 1 Takt
   *[other] { $count } Takte
}
canvas-rest = ruht
canvas-faults = { $count ->
    [one] 1 Störung
   *[other] { $count } Störungen
}
canvas-panics = { $count ->
    [one] 1 Panik
   *[other] { $count } Paniken
}
canvas-hangs = { $count ->
    [one] 1 Hänger
   *[other] { $count } Hänger
}
canvas-slow = { $count ->
    [one] 1 langsamer Aufruf
   *[other] { $count } langsame Aufrufe
}
canvas-leaks = { $count ->
    [one] 1 Leck
   *[other] { $count } Lecks
}
canvas-frame = Rahmen
    .name = Rahmen { $text }
    .size = Größe von Rahmen { $text }
canvas-note = Notiz
    .name = Notiz { $text }
canvas-mark-text = Text der Markierung
canvas-wires-more = und { $count } weitere
canvas-wire = { $output } nach { $input }
canvas-wire-delayed = { $wire }, voriger Wert

## Felder und ihre Anordnung

panel-graph = Graph
panel-node = Knoten
panel-overview = Überblick
panel-text = Text
panel-source = Quelltext
panel-help = Hilfe
panel-viewer = Betrachter
panel-problems = Probleme
    .count = Probleme { $count }
panel-history = Verlauf
panel-timeline = Aufzeichnung
panel-trace = Takte
panel-states = Presets
panel-sweep = Reihe
panel-plots = Kurven
panel-name = Feld { $panel }
panel-button = { $button }: { $panel }
panel-tear-off =
    .name = { $panel } abreißen
panel-close =
    .name = Feld { $panel } schließen
panel-dock = Andocken
panel-shut = Schließen
panel-border = Grenze zwischen { $first } und { $second }
dock-graph-stays = der Graph bleibt in diesem Fenster: die anderen Felder abreißen
dock-graph-open = der Graph bleibt offen
dock-keys = die Tasten für Felder wirken auf: { $panel }
dock-reset = die Felder sind wie am Anfang angeordnet
dock-viewer-beside = der Betrachter öffnet sich neben dem Graphen
dock-viewer-over = der Betrachter öffnet sich über dem Graphen
dock-choose = zuerst ein anderes Feld wählen, mit F6 oder einem Klick: der Graph behält seinen Platz
dock-already = { $panel } ist schon dort
language-now = Die Sprache ist Deutsch
