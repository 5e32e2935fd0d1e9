//! The view history as bytes, for map files and snapshots.
use super::{ViewHistory, AZIMUTHS, ELEVATIONS, LAYER};
use crate::belief::octree::Brick;

impl ViewHistory {
    /// The layer as bytes, little-endian: the number of blocks (u32), then for each its brick (u32), layer (u8), direction
    /// (u16), voxels (u64) and, for each of these, O_k as log-odds (f32) and C_k in 2^-20 (u32). In the order of brick, layer and
    /// direction, whatever was seen first.
    pub fn serialise(&self) -> Vec<u8> {
        let mut out = vec![0; 4];
        let mut count = 0u32;
        for (brick, layers) in self.layers.iter().enumerate() {
            for z in 0..layers.len() {
                let seen = self.directions(brick, z).filter(|(_, s, _)| s.seen != 0);
                let mut seen: Vec<_> = seen.collect();
                seen.sort_unstable_by_key(|(direction, _, _)| *direction);
                for (direction, sight, block) in seen {
                    count += 1;
                    out.extend((brick as u32).to_le_bytes());
                    out.push(z as u8);
                    out.extend((direction as u16).to_le_bytes());
                    out.extend(sight.seen.to_le_bytes());
                    for i in (0..LAYER).filter(|i| sight.seen >> i & 1 == 1) {
                        out.extend(block.log_odds[i].to_le_bytes());
                        out.extend(block.confidence[i].to_le_bytes());
                    }
                }
            }
        }
        out[..4].copy_from_slice(&count.to_le_bytes());
        out
    }

    /// The layer in such bytes, of a map with these bricks. Allocates at most some 40 bytes for each one that is read.
    pub fn parse(bytes: &[u8], bricks: &[Brick]) -> std::result::Result<Self, String> {
        let mut rest = bytes;
        let mut take = |n: usize| -> std::result::Result<&[u8], String> {
            let (head, tail) = rest.split_at_checked(n).ok_or("it ends too early")?;
            rest = tail;
            Ok(head)
        };
        let number = |bytes: &[u8]| bytes.iter().rev().fold(0u64, |n, b| n << 8 | u64::from(*b));
        let mut history = Self::default();
        for _ in 0..number(take(4)?) {
            let brick = number(take(4)?) as usize;
            let z = number(take(1)?) as usize;
            let direction = number(take(2)?) as usize;
            let seen = number(take(8)?);
            let known = bricks.get(brick).and_then(|b| b.known.get(z)).copied();
            if direction >= AZIMUTHS * ELEVATIONS || seen == 0 || seen & !known.unwrap_or(0) != 0 {
                return Err(format!(
                    "brick {brick}, layer {z}, direction {direction} was not to be seen"
                ));
            }
            if history.block(brick, z, direction).is_some() {
                return Err(format!(
                    "brick {brick}, layer {z}, direction {direction} stands there twice"
                ));
            }
            let (mut log_odds, mut now) = ([0.0; LAYER], [0; LAYER]);
            for i in (0..LAYER).filter(|i| seen >> i & 1 == 1) {
                log_odds[i] = f32::from_bits(number(take(4)?) as u32);
                now[i] = number(take(4)?) as u32;
                if !log_odds[i].is_finite() {
                    return Err(format!("log-odds {} are not finite", log_odds[i]));
                }
            }
            history.record(brick, z, direction, seen, &log_odds, &now);
        }
        if rest.is_empty() {
            Ok(history)
        } else {
            Err(format!("{} bytes too many", rest.len()))
        }
    }
}
