# The editor's window: bars, tours, dialogs, the canvas, the viewer.

## The bar above

top-changed = changed
    .hint = There are unsaved changes
top-keys = Keys
top-sweep = Sweep
top-presets = Presets
top-history = History
top-plots = Plots
top-text = Text
top-heat = Heat
top-problems = Problems
    .count = Problems { $count }
top-arguments = Arguments
    .count = Arguments { $count }
top-fit = Fit
top-find = Find
top-add = Add
top-save = Save
top-redo = Redo
top-undo = Undo
top-again = Run again
top-record = Record
    .stop = End recording
top-play = Play
    .pause = Pause
top-step = Step
top-loop = Loop
top-speed = { $speed } x
top-look = Look
top-run = Run
top-menu = More buttons, because the window is narrow
state-unfinished = { $count ->
    [0] unfinished: a node has nothing to read
    [one] unfinished: 1 input is not connected
   *[other] unfinished: { $count } inputs are not connected
}
state-unfinished-runs = { $count ->
    [0] unfinished; the last valid graph keeps running
    [one] unfinished: 1 input is not connected; the last valid graph keeps running
   *[other] unfinished: { $count } inputs are not connected; the last valid graph keeps running
}
state-recorded = shows the recording { $file }; the graph runs on
state-over = { $count ->
    [one] 1 frame
   *[other] { $count } frames
} in { $seconds } s, { $rate } fps
state-name = State: { $state }
state-disk-full = the disk is full: `{ $node }` has stopped writing
state-bypassed = `{ $node }` is bypassed after a fault
state-not-started = not started
state-no-nodes = no nodes yet: press A to add one
state-lacks = needs a value for { $arguments }
state-mistakes = the file has mistakes
state-is-starting = starting
state-change-failed = the change failed; the old graph keeps running
state-last-valid = the file has mistakes; the last valid graph keeps running
state-running = running
state-ended = the run has ended and its files are finished
state-rate = { $rate } fps
state-age = age p99 { $age }
state-drops = { $count ->
    [one] 1 drop
   *[other] { $count } drops
}

## The tour of the first start; words in brackets stand for the keys of actions

guide-runs = It runs already
    .words = Each box is a node of the graph, with a live picture of what it makes, its time and its rate.
guide-look = Look at a node
    .words = Click a node. The panel at the right shows what it reads, its values and its times. { $help } shows its help.
guide-change = Change a value
    .words = Move a slider: the value takes effect between two frames, and no frame is lost. { $undo } takes it back.
guide-closely = Look closely
    .words = { $view } opens the picture large: point at it for values, drag a line for a profile, { $compare } compares it with another one.
guide-wire = Wire while it runs
    .words = { $add } adds a node, dragging from port to port wires it. What does not fit is refused, with the reason.
guide-find = Find everything
    .words = { $commands } finds every command, node and value. { $problem } leads through problems, { $help } lists the keys. { $save } saves.
guide-name = Tour { $at } of { $count }: { $heading }
guide-next = Next stop
guide-skip = Skip the tour
guide-not-kept = { $folder } cannot be written: the tour comes again

## The tour of problems

tour-nothing = nothing is wrong: no mistakes, faults, idle nodes or lost ticks
tour-heading = { $at } of { $count }  ·  { $place }
tour-name = Problem { $heading }
tour-remedy = What to do: { $remedy }
tour-previous = Previous problem
tour-next = Next problem
tour-end = End the tour

## Help and source of nodes

learn-select = select one node of a known type for its help
learn-opens = { $file } opens in its own window
learn-not-opened = { $file } could not be opened: { $reason }
learn-source-elsewhere = the source of nodes is on `{ $machine }`, where the graph runs: edit it there
learn-no-source = select one node that is written in Python to see its source
learn-source-swapped = { $file } is saved and swapped in
learn-source-unsaved = the source is not saved: close it once more to lose the changes

## Files, conflicts, other machines

save-refused = not saved: the file was also changed on disk; choose in the bar above which text to keep
save-reloaded = the file changed on disk and was reloaded; undo restores the old text
save-reloaded-file = { $file } changed on disk and was reloaded; undo restores the old text
save-copy = saved as a copy, because the original belongs to the installation: { $file }
save-failed = { $file } was not saved: { $reason }
save-done = { $count ->
    [one] saved
   *[other] saved { $count } files
}
conflict-machine = The graph was changed on its machine, and in this window too. Choose which text to keep:
conflict-file = The file was changed on disk, and the graph in this window was changed too. Choose which text to keep:
conflict-part = { $file } was changed on disk, and in this window too. Choose which text to keep:
conflict-unsaved = Not saved.
conflict-theirs = Take the file's
    .hint = Undo restores the graph of this window
conflict-ours = Keep this one
    .hint = The next save replaces the file and keeps its text as a backup
conflict-kept = kept; the next save replaces the file and keeps its text as a backup
conflict-equal = { $count } equal lines
conflict-more = { $count } more lines
conflict-difference = Difference: { $ours } in this window (-), { $theirs } in the file (+)
    .name = Text of the difference
machine-read-only = `{ $machine }` lets this window only read; nothing was changed
machine-changed = the graph of `{ $machine }` was changed by { $who }
    .there = there
machine-copy = a copy is saved here: { $file }
machine-unreached = { $machine } is not reached: { $reason }
machine-lost = { $machine } is not reached for { $seconds } s: { $reason }; pictures are old, it is tried again
machine-ended = { $machine }: { $reason }
machine-edits = this window edits it
machine-reads = this window only reads
machine-runs = Runs on { $machine }: { $may }. No emergency stop from here
machine-runs-clock = Runs on { $machine }: { $may }, ages are right to { $error } ms (clock { $offset } ms, there and back in { $reach } ms). No emergency stop from here

## New graphs, arguments, parts

new-heading = A new graph
new-written = { $file } is written when you save
new-template = Template { $name }
template-cameras = Two cameras
    .about = Two cameras, videos or images side by side.
template-panorama = Panorama
    .about = Two rendered views become one wide picture.
template-depth = Depth
    .about = Two rendered views become a surface in mm.
template-empty = Empty
    .about = An empty graph; press A to add nodes.
new-drop = drop one file, or one for each of the two sides
new-unknown = { $file } is not a graph, image or video
args-none = the graph declares no arguments, and no overlay fits it
args-heading = Arguments of { $graph }
args-starts = The graph runs once it has what it requires. Files can be dropped here.
args-applies = Values apply to the running graph.
args-start = Start
args-apply = Apply
args-not-kept = the values were not remembered: { $reason }
args-no-place = no argument without a value takes { $file }
part-select-open = select a part to open it
part-select-nodes = select the nodes of the part first
part-select-dissolve = select a part to dissolve it
part-dissolved = { $part } is dissolved; its file stays as it is
part-heading = A part of { $count } nodes
part-name = Name of the part
    .hint = name
part-writes = Saving writes { $file }
part-make = Make the part
part-cancel = Cancel
part-used = { $part } is used { $count } times in this graph
part-applies = The change applies to each of them: { $users }.
part-others = Other graphs that use the file change too. Saving writes it.
part-change-all = Change all { $count }

## What happened

done-undone = undone: { $step }
done-redone = done again: { $step }
done-bypassed = { $node } is bypassed
done-preset = stored: preset { $name }
done-snapshot = snapshot { $number } is taken
done-restored = the graph is as in snapshot { $number }; Ctrl+Z goes back
done-restored-already = the graph is as in snapshot { $number } already
done-left-out = { $step }: left out { $first }
done-left-out-more = { $step }: left out { $first } and { $count } more
done-written = written: { $file }
done-not-written = the curves were not written: { $reason }
done-newest = this is the newest value in the history
done-oldest = this is the oldest value in the history
done-connected = connected: { $wires }
done-arranged = { $count ->
    [one] 1 node is arranged
   *[other] { $count } nodes are arranged
}
done-arranged-already = all nodes are arranged already
need-own-machine = the graph runs on another machine: record it there
need-valid = the graph has mistakes: only a graph that runs can be recorded
done-acknowledged = { $count ->
    [0] there is no fault to acknowledge
    [one] 1 fault is acknowledged
   *[other] { $count } faults are acknowledged
}
need-two-nodes = select at least two nodes to align
need-recording = nothing to play: no source reads files, and no recording is open (J shows the timeline)
need-recorded-graph = no node of this graph is in the recording: open the graph that was recorded
need-one-node = select one node to connect
need-image = { $node } has no image input yet: connect one, then pick
layout-unused = { $reason }; the panels are arranged as at first

## The palette

palette-name = Palette
palette-add = Add a node: type, family or what it does
palette-add-to-wire = Add a node for this wire
palette-connect = Connect: name of an input or output
palette-find = Find a node
palette-command = A command, a node, or a parameter of the graph
palette-loading = loading the plugins
palette-no-match = no match
palette-from = { $input } from { $output }
palette-part = part
palette-by-name = connect { $ports } by name
palette-to = connect { $ports } to { $node }
# Groups of words with one meaning, separated by semicolons, in small letters.
palette-synonyms = camera capture webcam live source; file video recording movie play; save write record store export; panorama stitch mosaic wide composite; depth disparity distance stereo; surface cloud points 3d mesh; instrument tool detect boxes yolo; mask segment instances; show display preview view look; smooth blur denoise filter; register align match homography; rectify calibrate calibration lens; robot arm joint kinematics; colour color palette colorize; crop cut region roi; scale resize shrink; arrange order layout tidy; undo revert back
palette-pick = Pick { $name }

## Values of pictures

probe-at = Value at { $found }
probe-range = { $low } to { $high }
probe-mean = { $low } to { $high }, mean { $mean }
probe-unknown = { $percent } % unknown
probe-thinned = thinned on the way
probe-histogram = Histogram: { $found }
probe-profile = Profile over { $length } px: { $found }
probe-nothing = nothing known

## The viewer

viewer-name = Viewer of { $output }
viewer-nothing = nothing yet
viewer-stale = no new packet for { $seconds } s
viewer-beside = Side by side
viewer-numbers-none = no tick of both outputs yet
viewer-numbers-unlike = the outputs differ in type or size
viewer-numbers-images = PSNR { $psnr } dB  ·  SSIM { $ssim }  ·  tick { $tick }
viewer-numbers-maps = end-point error { $mean } { $unit }, 95 % below { $p95 } { $unit }  ·  { $density } % known  ·  tick { $tick }
viewer-numbers-about = Of the whole packets of one tick, compared with { $output }. PSNR and SSIM are of luma, after one gain between the two is removed; the end-point error is the mean difference where both are known.
viewer-difference-is = mean difference { $mean } of 255, amplified four times
viewer-close = Close
viewer-surface = Surface
    .hint = Switches between a surface and the camera's view
viewer-difference = Difference
viewer-blink = Blink
viewer-wipe = Wipe
viewer-with-nothing = with nothing
viewer-compare = compare
    .name = Compare with
key-escape = Escape
surface-name = Surface of { $output }
surface-no-points = the cloud has no points in the chosen depth range
surface-foot = { $node } (foot)
surface-measure = Measure
    .hint = Distance of two points in mm: click them, or use arrow keys and Enter
surface-measuring = Measuring: click two points
surface-drifted = No distance: the calibration does not fit any more
surface-depth-from = depth from
    .name = Nearest depth shown
surface-depth-to = to
    .name = Farthest depth shown

## Points and rectangles on a picture

pick-here = Pick { $param } here
pick-point = Point { $number } of { $param }
pick-rectangle = Rectangle { $number } of { $param }
pick-corner = Rectangle { $number } corner { $corner } of { $param }
pick-add-point = Add a point
pick-add-rectangle = Add a rectangle
pick-add-hint = In the middle of the image; arrow keys move it by 1 px, with Shift by 10 px
pick-remove = Remove
    .hint = The last one touched (Delete)
pick-clear = Clear
pick-done = Done
pick-points-hint = click to add, drag to move
pick-rectangles-hint = drag to draw, handles to change

## The canvas

canvas-name = Graph
canvas-map = Map of the graph
canvas-node = Node { $node }
canvas-part = Part { $part }
canvas-open = open
    .name = Open { $node }
canvas-fold = fold
    .name = Fold { $part }
canvas-all-ports = All ports of { $node }
canvas-more = { $count } more
canvas-fewer = fewer
canvas-input = Input { $port }
canvas-output = Output { $port }
canvas-old = { $seconds } s old
canvas-age = age { $age }
canvas-rate = { $rate } fps
canvas-median = { $median } · p99 { $slow }
canvas-unfinished = unfinished
canvas-mistake = mistake
canvas-recorded = recorded
canvas-computed = computed from the recording
canvas-computing = computing { $percent } %
canvas-not-recorded = not in the recording
canvas-ticks = { $count ->
    [one] 1 tick
   *[other] { $count } ticks
}
canvas-rest = at rest
canvas-faults = { $count ->
    [one] 1 fault
   *[other] { $count } faults
}
canvas-panics = { $count ->
    [one] 1 panic
   *[other] { $count } panics
}
canvas-hangs = { $count ->
    [one] 1 hang
   *[other] { $count } hangs
}
canvas-slow = { $count ->
    [one] 1 slow call
   *[other] { $count } slow calls
}
canvas-leaks = { $count ->
    [one] 1 leak
   *[other] { $count } leaks
}
canvas-frame = Frame
    .name = Frame { $text }
    .size = Size of Frame { $text }
canvas-note = Note
    .name = Note { $text }
canvas-mark-text = Text of the mark
canvas-wires-more = and { $count } more
canvas-wire = { $output } to { $input }
canvas-wire-delayed = { $wire }, previous value

## Panels and their docks

panel-graph = Graph
panel-node = Node
panel-overview = Overview
panel-text = Text
panel-source = Source
panel-help = Help
panel-viewer = Viewer
panel-problems = Problems
    .count = Problems { $count }
panel-history = History
panel-timeline = Recording
panel-trace = Ticks
panel-states = Presets
panel-sweep = Sweep
panel-plots = Plots
panel-name = Panel { $panel }
panel-button = { $button }: { $panel }
panel-tear-off =
    .name = Tear off { $panel }
panel-close =
    .name = Close panel { $panel }
panel-dock = Dock
panel-shut = Close
panel-border = Border between { $first } and { $second }
dock-graph-stays = the graph stays in this window: tear the other panels off
dock-graph-open = the graph stays open
dock-keys = the keys for panels act on: { $panel }
dock-reset = the panels are arranged as at first
dock-viewer-beside = the viewer opens beside the graph
dock-viewer-over = the viewer opens over the graph
dock-choose = choose another panel first, by F6 or a click: the graph keeps its place
dock-already = { $panel } is there already
language-now = The language is English
