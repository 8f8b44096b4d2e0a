# The panels of the editor around the graph.

## Sweep

sweep-parameter = parameter
    .filter = Filter the parameters
    .name = Swept parameter
sweep-range = from, to
    .from = Sweep from
    .to = Sweep to
sweep-steps = Sweep steps
    .suffix = steps
sweep-measure = measure
    .name = Sweep measure
sweep-measures = choose
    .filter = Filter the measures
    .name = Known measures
sweep-pictures = pictures
    .hint = the graph's own sources
    .name = Recording to sweep over
    .file = File
    .file-hint = A recording (.mcap) that replaces the graph's sources
sweep-frames = of each
    .name = Frames per value
    .suffix = frames
sweep-cancel = Cancel
    .hint = The values measured so far stay
sweep-start = Start the sweep
    .hint = Runs beside the graph in batch mode, without nodes that have side effects
sweep-lacks-graph = The graph has mistakes: only a valid graph is swept.
sweep-lacks-parameter = The graph has no parameter that can be swept.
sweep-lacks-measure = Choose a measure: a scalar, a column of a table, a metric or a time.
sweep-about = Runs the graph once per value on the same frames. The graph in this window keeps running.
sweep-title = { $measure } over { $param }
sweep-not-started = did not start
sweep-preparing = preparing
sweep-cancelled = cancelled after { $count } of { $total }
sweep-done = { $count } of { $total } values
sweep-progress = { $count } of { $total }
sweep-failed = at { $value }: { $reason }
sweep-ends = smallest to largest
sweep-mean = mean
sweep-name = Sweep: { $values }
sweep-no-thread = no thread could be started: { $reason }
export-png-hint = Writes an image of the plot to out/
export-csv-hint = Writes all values to out/
export-curves-hint = Writes all points of the curves to out/

## Presets and snapshots

presets-heading = Presets
    .hint = name of the values as they are
    .name = Name of the preset
    .store = Store preset
    .none = No presets yet: each keeps the values of all nodes.
preset-apply = Apply preset { $name }
preset-remove = Remove preset { $name }
state-remove = remove
morph-name = Morph
    .from = Morph from
    .to = Morph to
snapshots-heading = Snapshots
    .take = Take a snapshot
    .none = No snapshots yet: each keeps the whole graph, to go back to.
snapshot-restore = Go back to snapshot { $number }
snapshot-remove = Remove snapshot { $number }
snapshot-blank = { $number }: no picture
age-now = just now
age-minutes = { $count } min ago
age-hours = { $count } h ago
age-days = { $count } d ago

## Recordings

timeline-about = A recording shows its pictures on the nodes; the graph keeps running. Record makes one of every output, from a new start of the graph on.
timeline-file = Recording
    .open = Open recording
    .browse = List the recordings
timeline-title = Pictures of the recording { $file }
    .hint = The graph keeps running; its own pictures come back when the recording is closed
timeline-close = Close recording
timeline-back = Step back
timeline-forward = Step forward
timeline-play = Play
timeline-pause = Pause
timeline-speed = Speed
timeline-loop-from = Loop from here
timeline-loop-to = Loop to here
timeline-loop-end = End loop
timeline-range = { $from } to { $to } s
timeline-moment = Moment of the recording
timeline-at = { $at } of { $length } s  ·  tick { $tick } of { $count }
timeline-at-name = Recording at { $moment }
timeline-compute = Compute the other nodes again
    .hint = The graph has changed since its outputs were computed
    .failed = The other nodes could not be computed: { $reason }
timeline-beside = Beside it: { $file }; V shows an output large, C compares it with that of the second run.
timeline-compare-end = End the comparison
timeline-second = Second recording
    .open = Compare with it
    .browse = List the recordings for the second one
record-start = Record
record-stop = End the recording and show it
record-runs = Recording to { $file }
record-begins = the graph starts again, recorded to { $file }
record-done = recorded { $count ->
    [one] 1 tick
   *[other] { $count } ticks
}: { $file }
record-failed = { $file } ended early: { $reason }

## Ticks

trace-heading = Dropped and late ticks
    .none = No tick has come through yet.
trace-elsewhere = The graph runs on { $machine }, which sends no paths of ticks: open it there for them. Counts of dropped ticks and the times of nodes are shown here too.
trace-path = Path
    .about = Choose a tick: its way through the graph, with the time of each node and its wait.
trace-dropped = Tick { $tick } of { $source } was dropped: { $behind } was still at { $nodes }
trace-on-its-way = its way
trace-late = Tick { $tick } of { $source }: { $time }
trace-in-the-way = Tick { $tick } of { $source }, which was in the way of tick { $dropped }
trace-path-of = Path of tick { $tick } of { $source }
trace-path-name = { $heading }: { $longest }
trace-no-output = no output
trace-waited = { $work }, waited { $time }
trace-waited-after = { $work }, waited { $time } after { $node }
trace-step = Step { $node }: { $found }

## History of values

history-back = Back
history-forward = Forward
history-empty = empty
history-default = default
history-default-is = { $value } (default)
history-count = { $count ->
    [0] No value was changed yet.
    [one] 1 change
   *[other] { $count } changes
}
history-applied = { $at } of { $count } changes are applied
history-tick = tick { $tick }
history-waits = waits
history-restore = Restores the values after this change
history-change = Change { $number }: { $param } from { $from } to { $to }
history-from-to = { $from }  to  { $to }

## The panel of a node

node-inputs = Inputs
node-outputs = Outputs
node-parameters = Parameters
node-sweep = sweep one over a range
    .name = Sweep a parameter
node-none = Select a node to see what it reads, its values and its times.
node-name = Name
    .hint = Name; Enter renames the node everywhere
node-unknown = { $type } · not known
node-help = help
    .name = Help of the node
node-source = source
    .name = Source of the node
part-open = Open
part-dissolve = Dissolve
part-users = used { $count } times
node-picture = Show { $output } large
    .hint = Click to open it in the viewer (V)
    .probe = point at the picture for a value
node-output = Shown output
node-idle = Why it is idle
go-to = Go to { $node }
node-rate = rate
node-rate-is = { $rate } fps
node-time = time
node-age = age
node-median = { $median }  ·  p99 { $slow }
node-ticks = ticks
node-copies = copies
node-ticks-are = { $count }  ·  { $dropped } dropped
node-trace = why ticks are dropped
    .name = Why ticks are dropped
node-fault = Last fault
    .seen = Acknowledge
node-fault-is = { $cause }, { $count } so far; then: { $done }
node-input = Input { $input }
node-not-connected = not connected

## Parameters

param-reopens = A change reopens the node.
param-differs = { $param } differs from the file
    .hint = Differs from the file
param-reset = reset
    .name = Reset { $param }
    .hint = Removes it from the file, so that the default applies
param-pick = on image
    .name = Pick { $param }
    .points = On the image: click to add, drag to move
    .rectangles = On the image: drag to draw, use the handles to change
param-browse = browse
    .name = Browse { $param }
    .hint = Files and folders
param-value = { $param } value

## Help of a node

help-of = Help of { $type }
help-about = { $family } · plugin { $plugin }
help-source = makes ticks of its own
help-device = owns a device
help-acts = acts beyond the graph
help-examples = Example graphs
    .none = No graph beside this one or in the installation uses it.
help-open = Open example { $name }
help-limits = Limits of { $param }: { $limits }
help-list = { $packet } list
help-optional = { $packet }, optional
limits-range = { $low } to { $high }
limits-from = from { $low }
limits-to = up to { $high }
limits-switch = on or off
limits-whole = a whole number
limits-number = a number
limits-steps = { $range } in steps of { $step }
limits-text = a text
limits-file = a file that exists
limits-path = a path
limits-numbers = { $count } numbers
limits-numbers-range = { $low } to { $high } numbers
limits-any-numbers = numbers
limits-default = { $limits }; default { $value }
limits-default-reopens = { $limits }; default { $value }; a change reopens the node
value-on = on
value-off = off
value-empty = empty

## The panel of the graph

overview-selected = { $count } nodes selected
overview-make-part = Make a part
overview-preset = Preset
overview-copy = copy
    .name = Copy { $command }
overview-more = more
overview-less = less
overview-time = Where time goes
overview-nothing = nothing runs
overview-share = { $time }   { $percent } %

## Curves

plot-times = Median time
    .axis = ms per call
plot-slowest = 99 % time
plot-rate = Rate
    .axis = calls per second
plot-queues = Queues
    .axis = packets waiting
    .none = all queues are empty: every node keeps up
plot-scatter = One over another
plot-histogram = Histogram over time
plot-x = Across
plot-y = Up
plot-scatter-about = { $count } pairs  ·  correlation { $correlation }
plot-scatter-count = { $count } pairs
plot-histogram-about = mean { $mean }  ·  standard deviation { $deviation }
plot-values = Values
    .axis = value
    .none = no scalar or table was received yet
plot-name = Times

## Mistakes and faults, text

mistakes-change = change not applied
mistakes-none = The file has no mistakes.
mistakes-faults = Faults, newest first
mistakes-at = { $seconds } s  { $node }
text-name = Text of the file

## Source of a node

source-save = Save and swap
    .hint = Ctrl+Enter
source-close = Close source
source-changed = changed
source-name = Source
source-unreadable = { $file } cannot be read: { $reason }
source-too-long = { $file } has more than 1 MiB
source-replaced = { $file } was changed by another program: close the source and open it again

## Plugins

plugins-heading = Plugins
    .reload = Reload
    .hint = Swaps rebuilt plugins into the running graph
plugins-nodes = nodes: { $nodes }

## Files

files-unreadable = { $folder } cannot be read: { $reason }
files-up = Up
    .hint = Parent folder (Backspace)
files-name = File name
    .hint = Type a part of the name, or a new name
files-empty = the folder is empty
files-new = no file has this name; Enter uses it for a new file
files-file = File { $name }
files-folder = Folder { $name }

overview-ages = Age at the end of each path
overview-age = { $median }   p99 { $slow }
go-to-end = Go to the end { $node }
