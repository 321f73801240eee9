// Statistics for tests of samplers: the chi-squared test with pooled cells, and thresholds for many tests at once.
#pragma once

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

namespace footlight::testing {

// Probability that a family of tests with fixed seeds was unlucky when written down.
inline constexpr double kFamilyAlpha = 1e-4;

// Level of one of count tests. Sidak 1967.
inline double sidak_level(int count) { return -std::expm1(std::log1p(-kFamilyAlpha) / count); }

// Upper tail of the chi-squared distribution, after Wilson and Hilferty 1931: a normal score, good to a percent in the
// score from 10 degrees of freedom on, which is what these tests have.
inline double chi_squared_tail(double statistic, int degrees) {
    const double spread = 2.0 / (9.0 * degrees);
    const double score = (std::cbrt(statistic / degrees) - (1 - spread)) / std::sqrt(spread);
    return 0.5 * std::erfc(score / std::sqrt(2.0));
}

// p-value of counts against expected counts. Cells that expect less than 5 are pooled into one.
inline double chi_squared_p(const std::vector<double>& expected, const std::vector<double>& observed) {
    double statistic = 0, pooled_expected = 0, pooled_observed = 0;
    int cells = 0;
    const auto add = [&](double e, double o) {
        statistic += (o - e) * (o - e) / e;
        ++cells;
    };
    for (std::size_t i = 0; i < expected.size(); ++i) {
        if (expected[i] >= 5) {
            add(expected[i], observed[i]);
        } else {
            pooled_expected += expected[i];
            pooled_observed += observed[i];
        }
    }
    if (pooled_expected >= 5) {
        add(pooled_expected, pooled_observed);
    } else if (pooled_observed > 40) {  // 5 expected, 40 seen: p < 1e-20
        return 0;
    }
    return chi_squared_tail(statistic, std::max(cells - 1, 1));
}

// p-value of equally likely cells.
inline double chi_squared_uniform_p(const std::vector<double>& observed) {
    const double total = std::accumulate(observed.begin(), observed.end(), 0.0);
    return chi_squared_p(std::vector<double>(observed.size(), total / static_cast<double>(observed.size())), observed);
}

}  // namespace footlight::testing
