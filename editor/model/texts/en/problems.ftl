# Why a node does nothing, and what is wrong with a graph and its run.

## Why a node does nothing

idle-not-started = the graph was not started
idle-mistakes = the file has mistakes, so nothing runs yet
idle-starting = the graph is starting
idle-ended = the run has ended
idle-stopped = the run was stopped: { $reason }
idle-mistake = `{ $node }` has a mistake in the file: { $mistake }
idle-not-running = `{ $node }` is not part of the running graph yet
idle-fault = `{ $node }` has a fault: { $reason }
idle-bypassed = `{ $node }` is bypassed since a fault: { $reason }
idle-stopped-run = `{ $node }` stopped the run with a fault: { $reason }
idle-ended-by-fault = `{ $node }` ended with a fault: { $reason }
idle-restarting = `{ $node }` is being restarted after a fault: { $reason }
idle-withheld = `{ $node }` sent a packet that was not delivered: { $reason }
idle-unknown-type = the type of `{ $node }` is not known
idle-source = { $count ->
    [0] the source `{ $node }` has sent nothing yet
    [one] the source `{ $node }` has sent 1 tick and none in the last half second
   *[other] the source `{ $node }` has sent { $count } ticks and none in the last half second
}
idle-not-connected = the input `{ $input }` of `{ $node }` is not connected
idle-waits = `{ $node }` waits for `{ $output }`
idle-no-input = no input of `{ $node }` is connected
idle-empty = `{ $node }` is skipped: its input { $outputs } runs but is empty
idle-apart = `{ $node }` is skipped: its inputs run, but one of them is empty or they never hold the same tick: { $outputs }

## Problems: where, cause, what to do

problem-last-change = the last change
    .cause = the change was not applied: { $reason }
    .remedy = correct it, or undo it with Ctrl+Z; the graph before it keeps running
problem-line = line { $line }
problem-line-of = { $file }, line { $line }
problem-mistake-remedy = correct the line; the last valid graph keeps running
problem-warning-remedy = correct the line, or leave it: the graph runs
problem-fault = { $reason } ({ $count } so far)
problem-idle-remedy = check what this node reads and its values; the nodes behind it wait for it
problem-losses = { $count } of its ticks were dropped, because a newer one came before there was room
problem-losses-remedy = `{ $node }` takes longest ({ $ms } ms): make it faster or the source slower; the path of a tick shows where it waits
problem-losses-remedy-source = make the source slower

## What to do about a fault

remedy-stop = correct the cause, then run the graph again
remedy-bypass = correct the cause; any edit of the node opens it again
remedy-open = check the device, file or model that the node names; it is tried again by itself
remedy-panic = an error in the plugin: report it with these words; `isolate` keeps it from other nodes
remedy-hang = the node does not return: check its device, or give it a `budget_ms` that fits
remedy-too-old = the node before this input is slow or has stopped: look at that node, or allow more with `max_age_ms`
remedy-incomplete = a slow node of the same source takes frames from it: let that node read with `align = "latest"`, or limit it with `max_rate_hz`
remedy-slow = the node is over its `budget_ms`: reduce its work, or raise the budget
remedy-output = the output is not as declared: check the node's values and inputs, else it is an error in the plugin
remedy-frames = the node keeps frames: shorten what it holds, else it is an error in the plugin
remedy-times = the source's times run backwards: check the camera's driver or the recording
remedy-silent = the node makes nothing of complete inputs: look at them, and at its limits
remedy-recording = the recording has a gap: check the disk
remedy-error = read the message; the node is restarted by itself

## Kinds of faults, and what was done about one

cause-error = error
cause-panic = panic
cause-hang = does not return
cause-open = could not be opened
cause-output = output not as declared
cause-format = wrong format
cause-size = wrong size
cause-number = not a number
cause-much = too much output
cause-exhausted = no frames left
cause-times = capture times run backwards
cause-silent = no output
cause-slow = over its budget
cause-leak = keeps frames
cause-recording = gap in the recording
cause-release = frame released twice
cause-crash = process ended
cause-incomplete = input incomplete
cause-old = input too old
after-restart = restarted
after-abandon = replaced by a new one
after-bypass = bypassed
after-stop = the run was stopped
after-end = ended
after-withhold = packet not delivered
after-note = noted
