// Multiple importance sampling: how much an estimate counts when another strategy could have made it too.
#pragma once

#include "math/simd.h"

namespace footlight {

// Veach's balance heuristic a / (a + b) for two densities, as a ratio of the smaller to the larger: nothing overflows
// or underflows together, infinite densities included, and w(a, b) + w(b, a) = 1. Both 0, or both infinite, is 1/2.
template <class F>
inline F balance_heuristic(F a, F b) {
    const F larger = max(a, b), smaller = min(a, b);
    const F ratio = select(smaller == larger, F(1), smaller / larger);
    return select(a >= b, F(1), ratio) / (F(1) + ratio);
}

}  // namespace footlight
