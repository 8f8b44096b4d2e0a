# What both windows draw alike.

## The form for arguments

form-cancel = Cancel
form-unchanged = The graph file is not changed.
form-overlays = Source of the images
form-own = as the graph has it
form-overlay = Overlay { $name }
form-default = default
form-default-is = default: { $value }
form-required = required
form-not-used = not used
form-range = { $low } to { $high }
form-clear = clear
    .name = Clear { $argument }
    .hint = Takes the value away, so that the default applies
form-argument = Argument { $argument }
form-cameras = Cameras
    .name = Cameras for { $argument }
form-browse = Browse
    .name = Browse { $argument }
