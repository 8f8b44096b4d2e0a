# Warum ein Knoten nichts tut, und was an einem Graphen und seinem Lauf nicht stimmt.

## Warum ein Knoten nichts tut

idle-not-started = der Graph wurde nicht gestartet
idle-mistakes = die Datei hat Fehler, daher läuft noch nichts
idle-starting = der Graph startet
idle-ended = der Lauf ist zu Ende
idle-stopped = der Lauf wurde angehalten: { $reason }
idle-mistake = „{ $node }“ hat einen Fehler in der Datei: { $mistake }
idle-not-running = „{ $node }“ gehört noch nicht zum laufenden Graphen
idle-fault = „{ $node }“ ist gestört: { $reason }
idle-bypassed = „{ $node }“ ist seit einer Störung überbrückt: { $reason }
idle-stopped-run = „{ $node }“ hat den Lauf mit einer Störung angehalten: { $reason }
idle-ended-by-fault = „{ $node }“ endete mit einer Störung: { $reason }
idle-restarting = „{ $node }“ startet nach einer Störung neu: { $reason }
idle-withheld = „{ $node }“ hat ein Paket gesendet, das nicht zugestellt wurde: { $reason }
idle-unknown-type = der Typ von „{ $node }“ ist nicht bekannt
idle-source = { $count ->
    [0] die Quelle „{ $node }“ hat noch nichts gesendet
    [one] die Quelle „{ $node }“ hat 1 Takt gesendet und keinen in der letzten halben Sekunde
   *[other] die Quelle „{ $node }“ hat { $count } Takte gesendet und keinen in der letzten halben Sekunde
}
idle-not-connected = der Eingang „{ $input }“ von „{ $node }“ ist nicht verbunden
idle-waits = „{ $node }“ wartet auf „{ $output }“
idle-no-input = kein Eingang von „{ $node }“ ist verbunden
idle-empty = „{ $node }“ wird übersprungen: sein Eingang { $outputs } läuft, ist aber leer
idle-apart = „{ $node }“ wird übersprungen: seine Eingänge laufen, aber einer ist leer oder sie haben nie denselben Takt: { $outputs }

## Probleme: wo, Ursache, was zu tun ist

problem-last-change = die letzte Änderung
    .cause = die Änderung wurde nicht übernommen: { $reason }
    .remedy = berichtigen oder mit Strg+Z zurücknehmen; der bisherige Graph läuft weiter
problem-line = Zeile { $line }
problem-line-of = { $file }, Zeile { $line }
problem-mistake-remedy = die Zeile berichtigen; der letzte gültige Graph läuft weiter
problem-warning-remedy = die Zeile berichtigen oder so lassen: der Graph läuft
problem-fault = { $reason } (bisher { $count })
problem-idle-remedy = prüfen, was dieser Knoten liest und welche Werte er hat; die Knoten dahinter warten auf ihn
problem-losses = { $count } seiner Takte gingen verloren, weil ein neuerer kam, bevor Platz war
problem-losses-remedy = „{ $node }“ braucht am längsten ({ $ms } ms): den Knoten schneller oder die Quelle langsamer machen; der Weg eines Taktes zeigt, wo er wartet
problem-losses-remedy-source = die Quelle langsamer machen

## Was bei einer Störung zu tun ist

remedy-stop = die Ursache beheben, dann den Graphen neu starten
remedy-bypass = die Ursache beheben; jede Änderung am Knoten öffnet ihn wieder
remedy-open = Gerät, Datei oder Modell prüfen, die der Knoten nennt; neue Versuche laufen von selbst
remedy-panic = ein Fehler im Plugin: mit diesen Worten melden; „isolate“ hält ihn von anderen Knoten fern
remedy-hang = der Knoten kehrt nicht zurück: sein Gerät prüfen oder ihm ein passendes „budget_ms“ geben
remedy-too-old = der Knoten vor diesem Eingang ist langsam oder steht: diesen Knoten ansehen, oder mit „max_age_ms“ mehr erlauben
remedy-incomplete = ein langsamer Knoten daneben nimmt ihm Bilder weg: diesen Knoten mit „align = "latest"“ lesen lassen oder ihm ein „max_rate_hz“ geben
remedy-slow = der Knoten überschreitet sein „budget_ms“: seine Arbeit verringern oder das Budget erhöhen
remedy-output = die Ausgabe ist nicht wie erklärt: Werte und Eingänge des Knotens prüfen, sonst ist es ein Fehler im Plugin
remedy-frames = der Knoten behält Bilder: verkürzen, was er festhält, sonst ist es ein Fehler im Plugin
remedy-times = die Zeiten der Quelle laufen rückwärts: Kameratreiber oder Aufzeichnung prüfen
remedy-silent = der Knoten macht nichts aus vollständigen Eingängen: diese und seine Grenzen ansehen
remedy-recording = die Aufzeichnung hat eine Lücke: den Datenträger prüfen
remedy-error = die Meldung lesen; der Knoten startet von selbst neu

## Arten von Störungen, und was danach geschah

cause-error = Fehler
cause-panic = Absturz im Plugin
cause-hang = kehrt nicht zurück
cause-open = ließ sich nicht öffnen
cause-output = Ausgang nicht wie deklariert
cause-format = falsches Format
cause-size = falsche Größe
cause-number = keine Zahl
cause-much = zu viel ausgegeben
cause-exhausted = keine Bilder mehr frei
cause-times = Aufnahmezeiten laufen rückwärts
cause-silent = keine Ausgabe
cause-slow = über seiner Zeit
cause-leak = gibt Bilder nicht frei
cause-recording = Lücke in der Aufzeichnung
cause-release = Bild zweimal freigegeben
cause-crash = Prozess beendet
cause-incomplete = Eingang unvollständig
cause-old = Eingang zu alt
after-restart = neu gestartet
after-abandon = durch einen neuen ersetzt
after-bypass = umgangen
after-stop = Lauf angehalten
after-end = beendet
after-withhold = Paket nicht ausgeliefert
after-note = vermerkt
