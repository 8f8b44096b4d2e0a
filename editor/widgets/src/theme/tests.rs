//! Colours are distinguishable, texts legible, in both themes.

use super::*;

/// Transforms of linear RGB that simulate colour vision deficiencies: Machado, Oliveira and Fernandes, "A Physiologically-based Model for
/// Simulation of Color Vision Deficiency", 2009, severity 1. The first one is normal vision.
const EYES: [(&str, [[f32; 3]; 3]); 4] = [
    ("usual", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    ("protanope", [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]),
    ("deuteranope", [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]),
    ("tritanope", [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]),
];

fn linear(color: Color32) -> [f32; 3] {
    [color.r(), color.g(), color.b()].map(|v| {
        let v = f32::from(v) / 255.0;
        if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    })
}

/// CIE L*a*b* under D65.
fn lab([r, g, b]: [f32; 3]) -> [f32; 3] {
    let curve = |t: f32| if t > 0.008856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 };
    let x = curve((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
    let y = curve(0.2126 * r + 0.7152 * g + 0.0722 * b);
    let z = curve((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn seen(color: Color32, eye: &[[f32; 3]; 3]) -> [f32; 3] {
    let light = linear(color);
    lab(eye.map(|row| row.iter().zip(light).map(|(a, b)| a * b).sum::<f32>().clamp(0.0, 1.0)))
}

/// Smallest difference of two colours of a set over all kinds of vision; about 2.3 is just noticeable.
fn least(colors: &[Color32]) -> f32 {
    let mut least = f32::MAX;
    for (_, eye) in &EYES {
        for (k, a) in colors.iter().enumerate() {
            for b in &colors[..k] {
                let apart: f32 = seen(*a, eye).iter().zip(seen(*b, eye)).map(|(x, y)| (x - y).powi(2)).sum();
                least = least.min(apart.sqrt());
            }
        }
    }
    least
}

fn contrast(a: Color32, b: Color32) -> f32 {
    let light = |color| {
        let [r, g, b] = linear(color);
        0.2126 * r + 0.7152 * g + 0.0722 * b + 0.05
    };
    (light(a) / light(b)).max(light(b) / light(a))
}

/// Runs a check with the palette of each theme.
fn in_both_themes(check: impl Fn(&str)) {
    for (name, palette) in [("dark", &DARK), ("light", &LIGHT)] {
        CURRENT.set(palette);
        check(name);
    }
    CURRENT.set(&DARK);
}

#[test]
fn colours_are_distinguishable_with_any_colour_vision() {
    in_both_themes(|theme| {
        let families = ["source", "stitch", "stereo", "tools", "arm", "filter", "sink", "unknown", "other"].map(family);
        let classes: Vec<Color32> = (0..8).map(class).collect();
        let packets = ["image", "depth", "cloud", "pose", "tip", "text"].map(packet);
        for (name, colors, apart) in
            [("families", &families[..], 18.0), ("classes", &classes, 14.0), ("packets", &packets, 20.0)]
        {
            assert!(least(colors) > apart, "{theme} {name}: {}", least(colors));
        }
        // Normal, past fault and current fault must differ more.
        let states = [live(), warn(), fault()];
        assert!(least(&states) > 18.0, "{theme}: {}", least(&states));
    });
}

#[test]
fn texts_and_marks_have_enough_contrast() {
    in_both_themes(|theme| {
        let mut grounds = vec![ground(), panel(), raised(), sunk()];
        if !is_light() {
            grounds.push(BLACK);
        }
        grounds.extend(palette().buttons);
        for ground in grounds {
            for text in [text(), muted(), accent(), fault(), warn()] {
                // Buttons carry normal text only.
                if palette().buttons.contains(&ground) && text != self::text() {
                    continue;
                }
                assert!(contrast(text, ground) > 4.5, "{theme}: {text:?} on {ground:?}: {}", contrast(text, ground));
            }
        }
        for class in (0..8).map(class) {
            assert!(contrast(on(class), class) > 4.2, "{theme} {class:?}: {}", contrast(on(class), class));
        }
        for share in [0.0, 0.3, 0.7, 1.0] {
            assert!(contrast(text(), heat(share)) > 4.5, "{theme}: heat {share}");
        }
        for mark in ["source", "stitch", "stereo", "tools", "arm", "filter", "sink", "other"].map(family) {
            assert!(contrast(mark, raised()) > 3.0, "{theme} {mark:?}: {}", contrast(mark, raised()));
        }
        for mark in ["image", "depth", "cloud", "pose", "tip", "text"].map(packet) {
            assert!(contrast(mark, raised()) > 3.0, "{theme} {mark:?}: {}", contrast(mark, raised()));
        }
    });
}
