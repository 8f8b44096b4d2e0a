# Das Theatre: die Anzeige für den Operationssaal.

## Meldungen, die mit dem größten Schaden zuerst: Text, übliche Ursache, was zu tun ist.

alarm-no-image = Kein Bild: { $reason }
    .cause = die Kamera ließ sich nicht öffnen
    .action = Kabel und Strom prüfen, andere Programme mit dieser Kamera schließen, Eingabetaste drücken
alarm-restarting = Kein Bild, Neustart läuft: Bildverarbeitung { $event }
    .cause = ein Plugin hat den Prozess beendet
    .action = mit dem Kamerabild weiterarbeiten; Neustart von selbst oder mit der Eingabetaste
alarm-machine-lost = { $machine } ist nicht erreichbar: { $reason }
    .cause = das Netzwerk oder das Programm dort
    .action = die Bilder sind alt: auf die Anzeige jenes Rechners schauen; neue Versuche laufen von selbst
alarm-camera-lost = { $camera } getrennt: kein Bild seit { $seconds } s
    .cause = Kabel, Strom oder Treiber
    .action = Kabel und Strom prüfen; neue Versuche laufen von selbst
alarm-camera-stuck = { $camera } steht still: dasselbe Bild seit { $seconds } s
    .cause = die Kamera oder ihr Wandler wiederholt ihr letztes Bild
    .action = auf den Monitor der Kamera sehen; die Kamera neu starten
alarm-emergency = Not-Halt: Arm gestoppt
    .cause = der Not-Halt wurde gedrückt, oder der Graph wurde neu gestartet
    .action = Arm sichern, dann zum Lösen den Not-Halt zwei Sekunden lang halten
alarm-swapped = Linke und rechte Kamera sind vertauscht
    .cause = die Kabel sind vertauscht
    .action = Kabel tauschen; nicht messen
alarm-was-swapped = Links und rechts vielleicht vertauscht: für dieses Bild nicht geprüft
    .cause = Kabel waren vertauscht, als es entstand oder als das zuletzt bekannt war
    .action = in diesem Bild nicht messen; zu einem neuen weitergehen
alarm-image-stale = Bild ist { $seconds } s alt: nicht das jetzige
    .cause = eine Stufe, die Kamera oder ihr Datenstrom kommt nicht mit
    .action = nicht bewegen; zum Kamerabild wechseln
alarm-drifted = Die Kalibrierung passt nicht mehr: Abstände können falsch sein, neu kalibrieren
    .cause = die Kameras haben sich gegeneinander verschoben
    .action = den Abständen nicht vertrauen; neu kalibrieren
alarm-out-of-step = Die Kameras zeigen verschiedene Zeitpunkte: Abstände können falsch sein
    .cause = was die Bilder aufnimmt oder wandelt, verzögert eines davon
    .action = den Abständen nicht vertrauen; die Verzögerung jeder Kamera prüfen
alarm-camera-only = Nur Kamerabild: { $reason }
    .cause = der Graph kann nicht laufen
    .action = mit dem Kamerabild weiterarbeiten; Ursache beheben, Eingabetaste drücken
alarm-stopped = Das System hat angehalten: { $reason }
    .cause = eine Stufe hat den Lauf beendet
    .action = zum Neustart die Eingabetaste drücken
alarm-view-stopped = { $view } steht
    .cause = eine Stufe davor ist gestört
    .action = stattdessen das Kamerabild verwenden
alarm-stage = Stufe „{ $stage }“ ist gestört
    .cause = ein Fehler in einem Plugin
    .action = die Ansicht prüfen, die davon abhängt; die Stufe startet von selbst neu
alarm-disk-full = Speicher voll: keine Aufnahme möglich
    .cause = weniger als 64 MiB sind frei
    .action = Speicherplatz schaffen; die Anzeige ist nicht betroffen
alarm-ended = Die Quelle ist zu Ende
    .cause = eine Aufzeichnung ist abgelaufen
    .action = zum Neustart die Eingabetaste drücken
alarm-image-old = Bild ist { $seconds } s alt
    .cause = eine Stufe oder die Kamera ist zu langsam
    .action = vor Bewegungen warten; zum Kamerabild wechseln
alarm-not-changed = { $reason }
    .cause = eine Änderung war nicht möglich
    .action = der bisherige Graph läuft weiter
alarm-disk-low = Speicher fast voll: { $size } frei
    .cause = weniger als 2 GiB sind während einer Aufnahme frei
    .action = Aufnahme beenden oder Speicherplatz schaffen
alarm-audit = Das Protokoll wird nicht geschrieben: { $reason }
    .cause = sein Ordner ist voll oder schreibgeschützt
    .action = Speicherplatz schaffen oder die Betreuung des Geräts informieren
alarm-pedal = Die Pedal-Einstellungen werden nicht verwendet: { $reason }
    .cause = ein Fehler in „pedal.toml“
    .action = F13 bis F17 und F20 oder die Tastatur verwenden; Datei berichtigen, dann neu öffnen
alarm-attached = Verbunden mit { $machine }: kein Not-Halt von hier
    .cause = der Graph läuft auf einem anderen Rechner
    .action = einen Arm nur an jenem Rechner stoppen
alarm-unlike = Bilder anders als die gelernten: Instrumente können fehlen oder falsch benannt sein
    .cause = andere Operation, anderes Endoskop oder Licht, als das Netz kennt, oder eine verschmutzte Linse
    .action = Linse reinigen; Namen, Rahmen und Spitzen der Instrumente nicht vertrauen
alarm-unlocked = Läuft trotz Abweichung von der Freigabe: { $difference }
    .cause = Dateien wurden seit der Freigabe geändert
    .action = nur für Versuche verwenden oder nach Prüfung neu freigeben
alarm-public = Andere Rechner erreichen diesen: { $nodes }
    .cause = der Graph sendet Bilder oder empfängt Nachrichten über diesen Rechner hinaus
    .action = sicherstellen, dass nur die vorgesehenen Rechner im Netzwerk sind

## Andere Worte dieser Meldungen

notice-camera-silent = { $camera } liefert kein Bild
notice-cameras-silent-for = Kein neues Bild: keines von { $cameras } seit { $seconds } s
notice-restarting-long = Kein Bild seit { $seconds } s, Neustart läuft: Bildverarbeitung { $event }
notice-cameras-until = Nur Kamerabild, alle Ansichten in { $seconds } s: Bildverarbeitung { $event }
notice-cameras-on-request = Nur Kamerabild, alle Ansichten mit der Eingabetaste: Bildverarbeitung immer wieder { $event }
notice-cameras-starting = Nur Kamerabild, alle Ansichten starten: Bildverarbeitung { $event }
notice-stage-silent = Stufe „{ $stage }“ antwortet nicht
notice-stage-closed = Stufe „{ $stage }“ kann nicht neu starten
notice-stage-exhausted = Stufe „{ $stage }“ hat keinen Speicher mehr
notice-stage-bypassed = Stufe „{ $stage }“ ist nach einer Störung überbrückt
notice-disk-full-for = Speicher voll: { $stages } kann nicht schreiben
notice-recording-gaps = Die Aufzeichnung hat Lücken: { $reason }
notice-name = Meldung: { $notice }
notice-action = Zu tun: { $action }
remark-name = Hinweis: { $remark }

## Was mit dem Prozess geschah, in dem der Graph läuft: setzt „Bildverarbeitung“ fort

worker-crashed = abgestürzt ({ $signal })
worker-crashed-in = in Knoten „{ $node }“ abgestürzt ({ $signal })
worker-killed = vom System beendet (SIGKILL), vielleicht fehlte Arbeitsspeicher
worker-terminated = von außen beendet (SIGTERM)
worker-signal = durch Signal { $signal } beendet
worker-exited = von selbst beendet (Code { $code })
worker-lost = verloren: { $reason }
worker-not-needed = nicht mehr gebraucht
worker-never-began = ohne Lebenszeichen und daher beendet
worker-silent = eine Sekunde lang ohne Antwort und daher beendet
worker-silent-at-end = am Ende fünf Sekunden lang ohne Antwort und daher beendet
worker-stuck = fünf Sekunden lang ohne Fortschritt und daher beendet
worker-bad-picture = beendet, weil sie ein unsinniges Bild sendete
worker-bad-message = beendet, weil sie eine unsinnige Nachricht sendete
worker-not-started = nicht gestartet: { $reason }
worker-not-started-again = nicht neu gestartet: { $reason }
worker-not-restarted = nicht neu gestartet: { $reason }
worker-locked-anew = nicht neu gestartet: der Graph wurde inzwischen neu freigegeben
worker-restarting = startet gerade neu: gleich noch einmal versuchen
worker-run-ended = der Lauf ist zu Ende
worker-refused = { $reason }

## Anstelle eines Bildes

no-image = Kein Bild
no-image-plain = kein Bild
no-image-starting = startet
no-image-starting-for = startet seit { $seconds } s
no-image-again = Dies beheben, dann zum Neustart die Eingabetaste drücken. Bei einer Kamera: Kabel und Strom prüfen und andere Programme schließen, die sie verwenden.
no-image-camera-tried = Die Kamera wird allein geöffnet. Kabel und Strom prüfen und andere Programme schließen, die sie verwenden.
no-image-retried = Neue Versuche laufen von selbst. Bei einer Kamera: Kabel und Strom prüfen und andere Programme schließen, die sie verwenden.

## Die Leiste oben

state-restarting = NEUSTART
state-unreached = NICHT ERREICHBAR
state-no-picture = KEIN BILD
state-starting = STARTET
state-stopped = ANGEHALTEN
state-frozen = EINGEFROREN
state-delayed = VERZÖGERT
state-live = LIVE
state-recording = AUFNAHME
    .name = Der Graph schreibt Dateien: { $nodes } { $size }
disk-free = { $size } frei
leave-hold = Zum Verlassen weiter halten
leave-name = Operationsansicht beenden: zwei Sekunden halten
mark-never = NICHT FREIGEGEBEN
    .line = dieser Graph wurde nicht geprüft
    .name = Nicht freigegeben: dieser Graph wurde nicht geprüft
mark-differs = OHNE FREIGABE
    .line = seit der Prüfung geändert
    .name = Ohne Freigabe: seit der Prüfung geändert

## Tasten

button-layout = Ansicht
button-freeze = Einfrieren
button-continue = Weiter
button-still = Foto
button-record = Aufnehmen
button-end-clip = Aufn. Ende
button-measure = Messen
button-again = Neu starten
button-more = Weitere Einstellungen
button-page = { $page } von { $pages }
key-space = Leertaste
key-enter = Eingabe
stop-arm = ARM STOPPEN
    .key = Taste { $key }
    .name = Not-Halt des Arms
    .release = Arm lösen: 2 s halten
arm-stopped = ARM GESTOPPT
    .hold = zum Lösen 2 s halten
arm-refused = Not-Halt nicht angenommen von { $nodes }: Arm ausschalten
setting-next = weiter
setting-on = an
setting-off = aus
language-is = Die Sprache ist Deutsch

## Ansichten

camera-name = { $name ->
    [Left] Linke Kamera
    [Right] Rechte Kamera
   *[other] Kamera { $name }
}
camera-only-name = Kamera
view-name = Ansicht { $title }
view-zoomed = { $title }  ·  { $factor } x
view-in-place = { $camera } (anstelle von { $view })
view-live = Live: { $camera }
view-whole = Ganzes Bild
view-turn = { $view } drehen
view-no-new-image = kein neues Bild
view-withdrawn = zu alt zum Anzeigen
view-old = { $seconds } s alt
view-not-zoomed = beim Messen wird das Bild nicht vergrößert
view-never-frozen = das Kamerabild selbst wird nie eingefroren
view-no-image-yet = es gibt noch kein Bild
three-d-off = 3D ist aus
three-d-side-by-side = 3D: nebeneinander
three-d-top-bottom = 3D: übereinander
three-d-rows = 3D: zeilenweise
three-d-none = dieser Graph hat kein Stereopaar für 3D
eye-left = Linkes Auge
eye-right = Rechtes Auge
eye-both = Beide Augen
eye-name = { $eye }: { $way }
eye-no-image = noch kein Bild

## Abstände

measure-name = Hier messen
measure-none = dieser Graph hat keine Punktwolke zum Messen
measure-waiting = Warten auf ein Bild mit Tiefe
measure-no-depth = Keine Tiefe an diesem Punkt: daneben tippen
measure-no-error = Kein Abstand: ohne Kalibrierung ist sein Fehler nicht bekannt
measure-drifted = Kein Abstand: die Kalibrierung passt nicht mehr
measure-swapped = Kein Abstand: linke und rechte Kamera sind vertauscht
measure-out-of-step = Kein Abstand: die Kameras zeigen verschiedene Zeitpunkte
measure-first = Ersten Punkt antippen
measure-second = Zweiten Punkt antippen
measure-again = Für eine neue Messung tippen
measure-length = { $length } ± { $error } mm
measure-depth = { $length } ± { $error } mm tief

## Fotos und Aufnahmen

saved = { $file } ist gespeichert
not-written = { $file } wurde nicht geschrieben: { $reason }
not-written-full = { $file } wurde nicht geschrieben: der Speicher ist voll
not-written-thread = das Foto wurde nicht geschrieben: der schreibende Thread ist beendet
disk-is-full = der Speicher ist voll
clip-needs-graph = eine Aufnahme braucht den ganzen Graphen; jetzt sind nur Fotos möglich
clip-nothing = dieser Graph zeigt kein Bild, es gibt nichts aufzunehmen
clip-needs-image = eine Aufnahme braucht ein Bild, dieser Graph zeigt aber nur { $packets }: Foto speichern oder dem Preset ein Bild hinzufügen
clip-and = { $first } und { $second }
clip-instead = { $view } ist kein Bild: die Aufnahme zeigt { $shown }
clip-not-started = die Aufnahme konnte nicht beginnen: { $reason }
clip-ended-early = { $file } endete vorzeitig: { $reason }; der Teil bis dahin ist gespeichert
clip-process-ended = { $file } endete vorzeitig: Bildverarbeitung { $event }; der Teil bis dahin ist gespeichert

## Die Checkliste

checklist-ready = Einsatzbereit
checklist-left = { $count ->
    [one] { $count } Punkt ist nicht bereit
   *[other] { $count } Punkte sind nicht bereit
}
checklist-name = Checkliste: { $heading }
check-name = Prüfpunkt { $check }: { $state }, { $found }
check-ready = bereit
check-attention = Achtung
check-missing = fehlt
check-cameras = Kameras
check-cameras-none = der Graph hat keine
check-image-lost = kein Bild mehr
check-image-none = noch kein Bild
check-image-old = Bild { $seconds } s alt
check-image = Bild { $ms } ms alt
check-calibration = Kalibrierung
check-calibration-swapped = links und rechts sind vertauscht
check-calibration-drifted = passt nicht mehr; neu kalibrieren
check-calibration-out-of-step = die Kameras zeigen verschiedene Zeitpunkte
check-calibration-none = fehlt im Graphen: Abstände ohne Fehlergrenze
check-calibration-fits = passt zu den Kameras
check-calibration-waits = noch nicht empfangen
check-arm = Arm { $node }
check-arm-stopped = gestoppt; zum Lösen den Not-Halt halten
check-arm-ready = läuft und lässt sich stoppen
check-arm-missing = läuft nicht
check-disk = Speicher
check-disk-full = voll: { $size } frei
check-disk-low = fast voll: { $size } frei
check-disk-ready = { $size } frei
check-disk-unknown = freier Platz ist nicht bekannt
check-lock = Freigabe
check-lock-signed = wie freigegeben, signiert von { $key }
check-lock-ready = wie freigegeben
check-lock-never = dieser Graph wurde nie freigegeben
check-lock-differs = weicht ab: { $difference }
check-network = Netzwerk
check-network-local = nur dieser Rechner: { $nodes }
check-network-public = andere Rechner erreichen es: { $nodes }
check-machine = Rechner { $machine }
check-machine-lost = nicht erreichbar: { $reason }
check-machine-clock = in { $reach } ms erreicht; Alter auf { $error } ms genau (Uhr dort { $offset } ms)
check-machine-no-clock = die Uhr dort ist nicht bekannt
check-pedal = Pedal
check-pedal-keys = { $count ->
    [one] { $count } Taste
   *[other] { $count } Tasten
}
check-audit = Protokoll
check-audit-problem = nicht geschrieben: { $reason }
listens-node = { $node } auf { $address }
listens-page = Webseite auf { $address }

## Argumente des Graphen

arguments-heading = Argumente von { $file }
arguments-drop = Dateien können auf das Fenster gezogen werden.
arguments-start = Start
arguments-apply = Übernehmen
arguments-none = der Graph hat keine Argumente
arguments-not-kept = die Werte wurden nicht gemerkt: { $reason }
exchange-arm = der Arm ist gestoppt: zuerst lösen
exchange-clip = eine Aufnahme läuft: zuerst beenden
exchange-restarting = die Bildverarbeitung startet gerade neu: gleich noch einmal versuchen
exchange-locked = der Graph wurde inzwischen freigegeben: Fenster schließen und neu öffnen
attached-elsewhere = dieses Fenster ist nur verbunden: Aufnahmen, Starts und Stopps geschehen dort, wo der Graph läuft
script-no-action = es gibt keine Aktion „{ $step }“

## Ein Theatre, das nicht geöffnet wurde

refused-title = Das Theatre konnte nicht geöffnet werden
refused-to-do = Was zu tun ist
refused-close = Schließen (Esc)
refused-differs = { $file } weicht von der Freigabe ab
refused-lock = Die Freigabe von { $file } ist nicht gültig
refused-mistakes = { $file } hat Fehler
refused-start = { $file } konnte nicht gestartet werden
refused-no-picture = { $file } hat kein Bild
refused-machine = „{ $machine }“ ist nicht erreichbar
remedy-restore = Die geänderten Dateien wiederherstellen.
remedy-lock-again = Oder den jetzigen Stand prüfen und neu freigeben:
remedy-lock = Den Graphen prüfen und neu freigeben:
remedy-unlocked = Oder ungeprüft öffnen; ein Zeichen auf dem Bildschirm weist darauf hin:
remedy-edit = Die Fehler im Editor berichtigen:
remedy-install = Panoscope neu installieren, dann den Graphen prüfen und freigeben:
remedy-views = Ausgänge mit Bildern in „views“ von „[preset]“ nennen.
remedy-close-programs = Andere Programme schließen, dann neu öffnen.
remedy-check = Das abstürzende Plugin finden:
remedy-attachable = Den Graphen dort mit --attachable starten und diesen Rechner mit --allow-read nennen:
