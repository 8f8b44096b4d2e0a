//! The phantom: through the real nodes in a graph, beside its exact truth.

use super::data::Picture;
use super::judge::{Judge, Truth};
use crate::error::{Context, Result};
use crate::packets::floats;
use crate::ruler::{DISTANCES_MM, Ruler, SIZE, graph, plan, points};
use crate::run;

/// Chains and the nodes that their disparities come from.
const CHAINS: [(&str, &str); 5] = [
    ("bm", "bm"),
    ("bm_wls", "bm_wls"),
    ("bm_wls_fbs", "bm_wls_fbs"),
    ("sgbm", "depth/match"),
    ("sgbm_wls", "depth/wls"),
];

impl Judge<'_> {
    pub fn phantom(&mut self) -> Result<()> {
        let mut ruler = Ruler::default();
        for distance_mm in DISTANCES_MM {
            self.scene("bowel", distance_mm, &mut ruler)?;
        }
        self.figures.extend(ruler.figures());
        if let Some(folder) = self.pictures {
            ruler.plot(&folder.join("phantom_lengths_and_depths.png"))?;
        }
        Ok(())
    }

    fn scene(&mut self, scene: &str, distance_mm: f64, ruler: &mut Ruler) -> Result<()> {
        let places = points(distance_mm);
        let text = graph(scene, distance_mm, &places);
        let mut ports = vec![
            ("scope", "disparity"),
            ("scope", "depth"),
            ("scope", "visible"),
            ("depth/points", "depth"),
            ("lengths", "table"),
            ("depths", "table"),
        ];
        let chains = ports.len();
        ports.extend(CHAINS.iter().map(|(_, node)| (*node, "disparity")));
        let views = ports.len();
        if self.own.is_some() {
            ports.extend([("scope", "left"), ("scope", "right")]);
        }
        let seen = run::run(self.session, &plan(&text, &ports))?;
        let packet =
            |index: usize| seen.packets[index].as_ref().with_context(|| format!("{:?} gave nothing", ports[index]));
        let map = |index: usize| floats(packet(index)?).context("a map is cut off");
        let (disparity, depth) = (map(0)?, map(1)?);
        let visible = packet(2)?.bytes().to_vec();
        let case = format!("phantom_{distance_mm:.0}mm");
        let input = format!("phantom {scene} 640x480 at {distance_mm} mm, where both cameras see");
        let truth = Truth { disparity, mask: Some(visible) };
        for (index, (chain, _)) in CHAINS.iter().enumerate() {
            self.against(&case, chain, SIZE, &map(chains + index)?, &truth, &input)?;
        }
        if self.own.is_some()
            && let Some(made) = self.own_graph(&Picture::of(packet(views)?)?, &Picture::of(packet(views + 1)?)?)?
        {
            self.against(&case, made.chain, SIZE, &made.disparity, &truth, &input)?;
        }
        let found = map(3)?;
        let mut errors: Vec<f32> =
            found.iter().zip(&depth).map(|(a, b)| (a - b).abs()).filter(|error| error.is_finite()).collect();
        errors.sort_by(f32::total_cmp);
        if let Some(middle) = errors.get(errors.len() / 2) {
            self.add(format!("depth_error_mm/{distance_mm:.0}"), f64::from(*middle), "mm", &input);
            self.add(
                format!("depth_error_p95_mm/{distance_mm:.0}"),
                f64::from(errors[errors.len() * 95 / 100]),
                "mm",
                &input,
            );
        }
        ruler.add(distance_mm, &places, &depth, packet(4)?, packet(5)?)
    }
}
