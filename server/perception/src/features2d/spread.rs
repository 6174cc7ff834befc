//! The best of many, but not all from one corner of the image.

/// Side of a cell, pixels.
const CELL: usize = 40;

/// Indices of `count` of the candidates, at most: those with the largest score, no more than twice its even share from
/// any cell of the image first, then the best of the others. In falling order of score, ties in order of index.
pub(super) fn select(places: &[(u16, u16)], scores: &[f32], count: usize, width: usize, height: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..places.len() as u32).collect();
    let by_score = |a: &u32, b: &u32| scores[*b as usize].total_cmp(&scores[*a as usize]).then(a.cmp(b));
    order.sort_unstable_by(by_score);
    if order.len() <= count {
        return order;
    }
    let columns = width.div_ceil(CELL);
    let cells = columns * height.div_ceil(CELL);
    let share = (2 * count).div_ceil(cells.max(1)).max(1) as u32;
    let mut taken = vec![0u32; cells];
    let (mut chosen, mut others) = (Vec::with_capacity(count), Vec::new());
    for i in order {
        let (u, v) = places[i as usize];
        let cell = usize::from(v) / CELL * columns + usize::from(u) / CELL;
        if chosen.len() < count && taken[cell] < share {
            taken[cell] += 1;
            chosen.push(i);
        } else {
            others.push(i);
        }
    }
    let missing = count - chosen.len();
    chosen.extend(others.into_iter().take(missing));
    chosen.sort_unstable_by(by_score);
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_busy_cell_leaves_room_for_the_others() {
        let mut places: Vec<(u16, u16)> = (0..100).map(|i| (i % 10, i / 10)).collect();
        places.extend((0..5).map(|i| (200 + i * 40, 100)));
        let scores: Vec<f32> = (0..105).map(|i| 200.0 - i as f32).collect();
        let chosen = select(&places, &scores, 20, 400, 200);
        assert_eq!(chosen.len(), 20);
        assert!((100..105).all(|i| chosen.contains(&i)), "{chosen:?}");
        assert_eq!(select(&places, &scores, 1000, 400, 200).len(), 105);
    }
}
