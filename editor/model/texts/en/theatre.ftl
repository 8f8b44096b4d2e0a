# The theatre.

## Notices, the most harmful first: text, usual cause, what to do. The README has the same table.

alarm-no-image = No image: { $reason }
    .cause = the camera did not open
    .action = check cable and power, close other programs that use it, press Enter
alarm-restarting = No image, restarting: the image processing { $event }
    .cause = a plugin ended the process
    .action = go on with the camera's image; it starts again by itself, or with Enter
alarm-machine-lost = { $machine } is not reached: { $reason }
    .cause = its network, or its program
    .action = the images are old: look at that machine's own display; it is tried again by itself
alarm-camera-lost = { $camera } lost: no image for { $seconds } s
    .cause = cable, power or driver
    .action = check cable and power; it is retried by itself
alarm-camera-stuck = { $camera } stuck: the same image for { $seconds } s
    .cause = the camera or its converter repeats its last image
    .action = look at the camera's own monitor; restart the camera
alarm-emergency = Emergency stop: the arm is stopped
    .cause = the stop was pressed, or the graph was started again
    .action = make the arm safe, then hold the stop for two seconds to release it
alarm-swapped = The left and right cameras are swapped
    .cause = cables are exchanged
    .action = exchange the cables; do not measure
alarm-was-swapped = Left and right may be swapped: not checked for this image
    .cause = cables were exchanged when it was taken, or when that was last known
    .action = do not measure in this image; go on to a new one
alarm-image-stale = Image is { $seconds } s old: not the present one
    .cause = a stage, the camera or its stream does not keep up
    .action = do not move; switch to the camera's view
alarm-drifted = The calibration does not fit any more: distances may be wrong, calibrate again
    .cause = the cameras moved against each other
    .action = do not rely on distances; calibrate again
alarm-out-of-step = The cameras show different instants: distances may be wrong
    .cause = what records or converts the images delays one of them
    .action = do not rely on distances; check the delay of each camera
alarm-camera-only = Camera image only: { $reason }
    .cause = the graph cannot run
    .action = go on with the camera's image; correct the reason, press Enter
alarm-stopped = The system stopped: { $reason }
    .cause = a stage stopped the run
    .action = press Enter to start again
alarm-view-stopped = { $view } has stopped
    .cause = a stage before it is in fault
    .action = use the camera's image in its place
alarm-stage = Stage `{ $stage }` has a fault
    .cause = an error in a plugin
    .action = check the view that depends on it; the stage restarts by itself
alarm-disk-full = The disk is full: nothing can be recorded
    .cause = less than 64 MiB are free
    .action = free space; the view is not affected
alarm-ended = The source has ended
    .cause = a recording is over
    .action = press Enter to start again
alarm-image-old = Image is { $seconds } s old
    .cause = a stage or the camera is too slow
    .action = wait before you move; switch to the camera's view
alarm-not-changed = { $reason }
    .cause = a change was not possible
    .action = the graph before it keeps running
alarm-disk-low = The disk is nearly full: { $size } free
    .cause = less than 2 GiB are free while files are written
    .action = free space, or end the clip
alarm-audit = The audit log is not written: { $reason }
    .cause = its folder is full or read-only
    .action = free space, or tell who looks after the machine
alarm-pedal = The pedal's settings are not used: { $reason }
    .cause = a mistake in `pedal.toml`
    .action = use F13 to F17 and F20, or the keyboard; correct the file, then open the theatre again
alarm-attached = Attached to { $machine }: no emergency stop from here
    .cause = the graph runs on another machine
    .action = stop an arm at that machine only
alarm-unlike = Pictures unlike those learned from: instruments may be missed or named wrongly
    .cause = another kind of operation, endoscope or light than the network knows, or a dirty lens
    .action = clean the lens; do not rely on names, boxes and tips of instruments
alarm-unlocked = Runs although it differs from its lock: { $difference }
    .cause = files changed since the graph was locked
    .action = use it for trials only, or lock it again after testing
alarm-public = Other machines can reach this one: { $nodes }
    .cause = the graph serves pictures or takes messages beyond this machine
    .action = be sure that only the intended machines share the network

## Other words of these notices

notice-camera-silent = { $camera } delivers no image
notice-cameras-silent-for = No new image: none from { $cameras } for { $seconds } s
notice-restarting-long = No image for { $seconds } s, restarting: the image processing { $event }
notice-cameras-until = Camera image only, all views in { $seconds } s: the image processing { $event }
notice-cameras-on-request = Camera image only, press Enter for all views: the image processing { $event } again and again
notice-cameras-starting = Camera image only, all views are starting: the image processing { $event }
notice-stage-silent = Stage `{ $stage }` does not respond
notice-stage-closed = Stage `{ $stage }` cannot start again
notice-stage-exhausted = Stage `{ $stage }` has no memory left
notice-stage-bypassed = Stage `{ $stage }` is bypassed after a fault
notice-disk-full-for = The disk is full: { $stages } cannot write
notice-recording-gaps = Recording has gaps: { $reason }
notice-name = Notice: { $notice }
notice-action = To do: { $action }
remark-name = Remark: { $remark }

## What happened to the process that runs the graph: continues "the image processing"

worker-crashed = crashed ({ $signal })
worker-crashed-in = crashed in node `{ $node }` ({ $signal })
worker-killed = was killed (SIGKILL), perhaps because memory ran out
worker-terminated = was ended from outside (SIGTERM)
worker-signal = was ended by signal { $signal }
worker-exited = ended by itself (exit code { $code })
worker-lost = is lost: { $reason }
worker-not-needed = was not needed any more
worker-never-began = did not begin to work and was ended
worker-silent = did not answer for one second and was ended
worker-silent-at-end = did not answer for five seconds at its end and was ended
worker-stuck = was stuck for five seconds and was ended
worker-bad-picture = sent a malformed picture and was ended
worker-bad-message = sent a malformed message and was ended
worker-not-started = could not be started: { $reason }
worker-not-started-again = could not start again: { $reason }
worker-not-restarted = cannot be started again: { $reason }
worker-locked-anew = cannot be started again: the graph was locked anew meanwhile
worker-restarting = is being restarted: try again in a moment
worker-run-ended = it ended
worker-refused = { $reason }

## In place of an image

no-image = No image
no-image-plain = no image
no-image-starting = starting
no-image-starting-for = starting for { $seconds } s
no-image-again = Correct this, then press Enter to start again. For a camera: check its cable and power, and close other programs that use it.
no-image-camera-tried = The camera is being opened alone. Check its cable and power, and close other programs that use it.
no-image-retried = It is retried automatically. For a camera: check its cable and power, and close other programs that use it.

## The bar above

state-restarting = RESTARTING
state-unreached = NOT REACHED
state-no-picture = NO PICTURE
state-starting = STARTING
state-stopped = STOPPED
state-frozen = FROZEN
state-delayed = DELAYED
state-live = LIVE
state-recording = REC
    .name = The graph writes files: { $nodes } { $size }
disk-free = { $size } free
leave-hold = Keep holding to leave
leave-name = End the theatre: hold for two seconds
mark-never = NOT LOCKED
    .line = this graph was not verified
    .name = Not locked: this graph was not verified
mark-differs = UNLOCKED
    .line = changed since it was verified
    .name = Unlocked: changed since it was verified

## Buttons and keys

button-layout = Layout
button-freeze = Freeze
button-continue = Continue
button-still = Still
button-record = Record
button-end-clip = End clip
button-measure = Measure
button-again = Start again
button-more = More settings
button-page = { $page } of { $pages }
key-space = Space
key-enter = Enter
stop-arm = STOP ARM
    .key = key { $key }
    .name = Emergency stop of the arm
    .release = Release the arm: hold 2 s
arm-stopped = ARM STOPPED
    .hold = hold 2 s to release
arm-refused = { $nodes } did not accept the stop: switch the arm off
setting-next = next
setting-on = on
setting-off = off
language-is = The language is English

## Views

camera-name = { $name ->
    [Left] Left camera
    [Right] Right camera
   *[other] { $name } camera
}
camera-only-name = Camera
view-name = View { $title }
view-zoomed = { $title }  ·  { $factor } x
view-in-place = { $camera } (in place of { $view })
view-live = Live: { $camera }
view-whole = Whole picture
view-turn = Turn { $view }
view-no-new-image = no new image
view-withdrawn = too old to show
view-old = { $seconds } s old
view-not-zoomed = the picture is not zoomed while distances are measured
view-never-frozen = the camera's own image is never frozen
view-no-image-yet = there is no image yet
three-d-off = 3-D is off
three-d-side-by-side = 3-D: side by side
three-d-top-bottom = 3-D: top and bottom
three-d-rows = 3-D: alternate rows
three-d-none = this graph has no stereo pair to show in 3-D
eye-left = Left eye
eye-right = Right eye
eye-both = Both eyes
eye-name = { $eye }: { $way }
eye-no-image = no image yet

## Distances

measure-name = Measure here
measure-none = this graph has no point cloud to measure in
measure-waiting = Waiting for an image with depth
measure-no-depth = No depth at this point: tap beside it
measure-no-error = No distance: without a calibration its error is not known
measure-drifted = No distance: the calibration does not fit any more
measure-swapped = No distance: the left and right cameras are swapped
measure-out-of-step = No distance: the cameras show different instants
measure-first = Tap the first point
measure-second = Tap the second point
measure-again = Tap to measure again
measure-length = { $length } ± { $error } mm
measure-depth = { $length } ± { $error } mm deep

## Stills and clips

saved = { $file } is saved
not-written = { $file } was not written: { $reason }
not-written-full = { $file } was not written: the disk is full
not-written-thread = the still was not written: the writing thread has ended
disk-is-full = the disk is full
clip-needs-graph = a clip needs the whole graph; only stills can be saved now
clip-nothing = this graph shows no image, so there is nothing to record
clip-needs-image = a clip needs an image, but this graph shows only { $packets }: save a still, or add an image to the preset
clip-and = { $first } and { $second }
clip-instead = { $view } is not an image: the clip shows { $shown }
clip-not-started = the clip could not be started: { $reason }
clip-ended-early = { $file } ended early: { $reason }; the part recorded so far is saved
clip-process-ended = { $file } ended early: the image processing { $event }; the part recorded so far is saved

## The checklist

checklist-ready = Ready for use
checklist-left = { $count ->
    [one] { $count } point is not ready
   *[other] { $count } points are not ready
}
checklist-name = Checklist: { $heading }
check-name = Check { $check }: { $state }, { $found }
check-ready = ready
check-attention = attention
check-missing = missing
check-cameras = Cameras
check-cameras-none = the graph has none
check-image-lost = no image any more
check-image-none = no image yet
check-image-old = image { $seconds } s old
check-image = image { $ms } ms old
check-calibration = Calibration
check-calibration-swapped = left and right are swapped
check-calibration-drifted = does not fit any more; calibrate again
check-calibration-out-of-step = the cameras show different instants
check-calibration-none = not in the graph: distances have no error bound
check-calibration-fits = fits the cameras
check-calibration-waits = not received yet
check-arm = Arm { $node }
check-arm-stopped = stopped; hold the stop to release it
check-arm-ready = runs and can be stopped
check-arm-missing = does not run
check-disk = Disk
check-disk-full = full: { $size } free
check-disk-low = nearly full: { $size } free
check-disk-ready = { $size } free
check-disk-unknown = its free space is not known
check-lock = Lock
check-lock-signed = as locked, signed by { $key }
check-lock-ready = as locked
check-lock-never = this graph was never locked
check-lock-differs = differs: { $difference }
check-network = Network
check-network-local = this machine only: { $nodes }
check-network-public = other machines reach it: { $nodes }
check-machine = Machine { $machine }
check-machine-lost = not reached: { $reason }
check-machine-clock = reached in { $reach } ms; ages are right to { $error } ms (its clock is { $offset } ms)
check-machine-no-clock = its clock is not known
check-pedal = Pedal
check-pedal-keys = { $count ->
    [one] { $count } key
   *[other] { $count } keys
}
check-audit = Audit log
check-audit-problem = not written: { $reason }
listens-node = { $node } at { $address }
listens-page = web page at { $address }

## Arguments of the graph

arguments-heading = Arguments of { $file }
arguments-drop = Files can be dropped on the window.
arguments-start = Start
arguments-apply = Apply
arguments-none = the graph has no arguments
arguments-not-kept = the values were not remembered: { $reason }
exchange-arm = the arm is stopped: release it first
exchange-clip = a clip is being recorded: end it first
exchange-restarting = the image processing is being restarted: try again in a moment
exchange-locked = the graph was locked meanwhile: close the theatre and open it again
attached-elsewhere = this window is attached: clips, starts and stops are made where the graph runs
script-no-action = there is no action `{ $step }`

## A theatre that did not open

refused-title = The theatre could not be opened
refused-to-do = What to do
refused-close = Close (Esc)
refused-differs = { $file } differs from its lock
refused-lock = The lock of { $file } is not valid
refused-mistakes = { $file } has mistakes
refused-start = { $file } could not be started
refused-no-picture = { $file } has no image
refused-machine = `{ $machine }` is not reached
remedy-restore = Restore the changed files.
remedy-lock-again = Or verify the graph as it is now, and lock it again:
remedy-lock = Verify the graph, and lock it again:
remedy-unlocked = Or open it unverified; a mark on the screen will show this:
remedy-edit = Correct them in the editor:
remedy-install = Install Panoscope again, then verify the graph and lock it:
remedy-views = Name outputs with images in `views` of `[preset]`.
remedy-close-programs = Close other programs, then open it again.
remedy-check = Find the plugin that crashes:
remedy-attachable = Start the graph there with --attachable, and name this machine with --allow-read:
