/// A change at one position in the sources of the engine.
pub(crate) struct Change {
    pub file: &'static str,
    /// Text that occurs exactly once in the file.
    pub from: &'static str,
    pub to: &'static str,
}

/// Defects that the campaign must find, each at one position in the runtime.
pub(crate) const MUTATIONS: &[(&str, Change)] = &[
    (
        "skip-reference",
        Change {
            file: "memory/mod.rs",
            from: "            memory().retain(self.0.buffer);\n",
            to: "            if !panoscope_sim::world::is_mutated(\"skip-reference\") {\n\
                 \x20               memory().retain(self.0.buffer);\n            }\n",
        },
    ),
    (
        "wrong-tick",
        Change {
            file: "threads.rs",
            from: "outputs.push(unsafe { FrameRef::adopt(Frame { tick, ..raw }) });",
            to: "let wrong = panoscope_sim::world::is_mutated(\"wrong-tick\") && tick.seq % 8 == 7;\n\
                 \x20           let seq = if wrong { tick.seq - 1 } else { tick.seq };\n\
                 \x20           outputs.push(unsafe { FrameRef::adopt(Frame { tick: Tick { seq, ..tick }, ..raw }) });",
        },
    ),
    (
        "mix-ticks",
        Change {
            file: "join.rs",
            from: "                Rule::Exact => slot.queue.pop_front(),\n",
            to: "                Rule::Exact if panoscope_sim::world::is_mutated(\"mix-ticks\") => slot.queue.pop_back(),\n\
                 \x20               Rule::Exact => slot.queue.pop_front(),\n",
        },
    ),
    (
        "change-without-rest",
        Change {
            file: "apply/mod.rs",
            from: "self.wait_for(until, || change.held.iter().find_map(|held| busy_member(old, held)))?;",
            to: "if !panoscope_sim::world::is_mutated(\"change-without-rest\") {\n\
                 \x20               self.wait_for(until, || change.held.iter().find_map(|held| busy_member(old, held)))?;\n\
                 \x20           }",
        },
    ),
    (
        "drop-held",
        Change {
            file: "region.rs",
            from: "        let waited: Vec<_> = std::iter::from_fn",
            to: "        if panoscope_sim::world::is_mutated(\"drop-held\") {\n            state.pending.pop_front();\n        }\n\
                 \x20       let waited: Vec<_> = std::iter::from_fn",
        },
    ),
    (
        "drop-uncounted",
        Change {
            file: "region.rs",
            from: "                dropped = state.pending.pop_back();\n",
            to: "                dropped = state.pending.pop_back();\n\
                 \x20               if panoscope_sim::world::is_mutated(\"drop-uncounted\") {\n                    dropped = None;\n                }\n",
        },
    ),
    (
        "write-shared",
        Change {
            file: "host.rs",
            from: "    if !lent && own && memory().references(frame.buffer) == 1 {\n",
            to: "    if panoscope_sim::world::is_mutated(\"write-shared\") || (!lent && own && memory().references(frame.buffer) == 1) {\n",
        },
    ),
    (
        "release-what-is-not-held",
        Change {
            file: "retained.rs",
            from: "        memory().release(id);\n    } else {\n        refuse();\n",
            to: "        memory().release(id);\n    } else if panoscope_sim::world::is_mutated(\"release-what-is-not-held\") {\n\
                 \x20       memory().release(id);\n    } else {\n        refuse();\n",
        },
    ),
    (
        "forget-retained",
        Change {
            file: "instance.rs",
            from: "        self.retained.reclaim();\n",
            to: "        if !panoscope_sim::world::is_mutated(\"forget-retained\") {\n            self.retained.reclaim();\n        }\n",
        },
    ),
    (
        "abandon-without-skip",
        Change {
            file: "watch.rs",
            from: "            self.skip_from(plan, node, tick, &mut ready);\n",
            to: "            if !panoscope_sim::world::is_mutated(\"abandon-without-skip\") {\n\
                 \x20               self.skip_from(plan, node, tick, &mut ready);\n            }\n",
        },
    ),
    (
        "go-on-after-abandon",
        Change {
            file: "call/mod.rs",
            from: "        if !self.busy.end(start_ns) {\n",
            to: "        if !self.busy.end(start_ns) && !panoscope_sim::world::is_mutated(\"go-on-after-abandon\") {\n",
        },
    ),
    (
        "keep-old-values",
        Change {
            file: "call/mod.rs",
            from: "        if let Some(snapshot) = self.config.newer_values(exec.snapshot()) {\n",
            to: "        let newer = self.config.newer_values(exec.snapshot());\n\
                 \x20       if let Some(snapshot) = newer.filter(|_| !panoscope_sim::world::is_mutated(\"keep-old-values\")) {\n",
        },
    ),
    (
        "close-without-completing",
        Change {
            file: "call/finish.rs",
            from: "        self.finish(context, &mut instance);\n",
            to: "        if !panoscope_sim::world::is_mutated(\"close-without-completing\") {\n\
                 \x20           self.finish(context, &mut instance);\n        }\n",
        },
    ),
];
