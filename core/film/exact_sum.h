// A sum of floats that does not depend on the order of its terms.
#pragma once

namespace footlight {

// Unevaluated sum of two doubles, 106 bits. Terms are floats (24 bits), so every addition is exact as long as the terms
// span less than 2^80 in magnitude: any order and any grouping of the samples give the same bits. Beyond that span the
// lost part is below 2^-80 of the sum. Error-free transformation: Knuth, TAOCP 2, 4.2.2.
struct ExactSum {
    double high = 0;
    double low = 0;

    void add(double x) {
        const double sum = high + x;
        const double rest = sum - high;
        low += (high - (sum - rest)) + (x - rest);
        high = sum;
    }
    void add(const ExactSum& other) {
        add(other.high);
        add(other.low);
    }
    [[nodiscard]] double value() const { return high + low; }
};

}  // namespace footlight
