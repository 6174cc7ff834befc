//! Packing by wide instructions against the plain one.

use super::*;
use proptest::prelude::*;

/// Coarse now and then, so that ties occur.
fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![-1.0..1.0f32, (-2i8..2).prop_map(f32::from), Just(f32::INFINITY)]
}

fn leaf() -> impl Strategy<Value = Leaf> {
    let sixteen = || prop::array::uniform16(coordinate());
    (sixteen(), sixteen(), sixteen(), prop::array::uniform16(any::<u32>())).prop_map(|(xs, ys, zs, indices)| Leaf {
        xs,
        ys,
        zs,
        indices,
    })
}

/// Distances, indices, offsets and ranks of what is found in leaves.
fn found<P: Packing>(packing: P, leaves: &[Leaf], query: &Query) -> (Vec<u32>, Vec<u32>, [Vec<f32>; 3], Vec<i32>) {
    let mut near = Near::new();
    leaves.iter().for_each(|leaf| packing.append(leaf, query, &mut near));
    near.rank(packing, 8);
    let n = near.len;
    let distances2 = near.distances2[..n].iter().map(|d| d.to_bits()).collect();
    (distances2, near.indices[..n].to_vec(), near.offsets.each_ref().map(|o| o[..n].to_vec()), near.ranks[..n].to_vec())
}

proptest! {
    #[test]
    fn every_processor_finds_the_same(
        leaves in prop::collection::vec(leaf(), 0..12), q in prop::array::uniform3(-1.0..1.0f32), limit2 in 0.0..6.0f32,
    ) {
        let query = Query { q, limit2, with_offsets: true };
        let plain = found(Plain, &leaves, &query);
        let mut order: Vec<usize> = (0..plain.0.len()).collect();
        if order.len() <= RANKED {
            order.sort_by_key(|&i| plain.0[i]);
            prop_assert!(order.iter().enumerate().all(|(rank, &i)| plain.3[i] == rank as i32));
        }
        #[cfg(target_arch = "x86_64")]
        {
            if has_avx2() {
                // SAFETY: it has.
                #[allow(unsafe_code)]
                let packing = unsafe { Avx2::known() };
                prop_assert_eq!(&found(packing, &leaves, &query), &plain);
            }
            if has_avx2() && has_avx512() {
                // SAFETY: it has.
                #[allow(unsafe_code)]
                let packing = unsafe { Avx512::known() };
                prop_assert_eq!(&found(packing, &leaves, &query), &plain);
            }
        }
    }
}
