// Laws of math/frame.h: frames are orthonormal everywhere, and there and back is the identity.
#include "math/frame.h"

#include <gtest/gtest.h>

#include "math/lanes.h"

namespace footlight::testing {
namespace {

using Maker = Frame<float> (*)(Vec3<float>);

// The naive formula: singular at n = -z. Frisvad 2012.
Frame<float> frisvad(Vec3<float> n) {
    if (n.z < -0.9999999F) return {{0, -1, 0}, {-1, 0, 0}, n};
    const float a = 1 / (1 + n.z);
    const float b = -n.x * n.y * a;
    return {{1 - n.x * n.x * a, b, -n.x}, {b, 1 - n.y * n.y * a, -n.y}, n};
}

std::vector<Vec3<double>> normals() {
    std::vector<Vec3<double>> all{{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}, {1, 0, -0.0}};
    Uniform uniform(1);
    for (int i = 0; i < 100000; ++i) {
        const double z = 2 * uniform.next<double>() - 1;
        const double phi = 2 * kPi * uniform.next<double>();
        const double r = std::sqrt(1 - z * z);
        all.push_back({r * std::cos(phi), r * std::sin(phi), z});
    }
    for (double tilt = 0.1; tilt > 1e-8; tilt *= 0.5) {
        for (int k = 0; k < 16; ++k) {
            const double phi = 2 * kPi * k / 16;
            for (const double side : {1.0, -1.0}) {
                all.push_back({std::sin(tilt) * std::cos(phi), std::sin(tilt) * std::sin(phi), side * std::cos(tilt)});
            }
        }
    }
    return all;
}

// Largest deviation of t, b, n from orthonormality, the length of n (which is given) aside.
double deviation(const Frame<double>& f) {
    const double lengths = std::max(std::abs(length(f.t) - 1), std::abs(length(f.b) - 1));
    const double angles = std::max({std::abs(dot(f.t, f.b)), std::abs(dot(f.t, f.n)), std::abs(dot(f.b, f.n))});
    const double handed = std::abs(dot(cross(f.t, f.b), f.n) - 1);
    return std::isfinite(lengths + angles + handed) ? std::max({lengths, angles, handed}) : 1e30;
}

double worst_deviation(Maker make) {
    double worst = 0;
    for (const Vec3<double>& n : normals()) {
        const Frame<float> f = make(vector<float>(n));
        worst = std::max(worst, deviation({lane(f.t, 0), lane(f.b, 0), lane(f.n, 0)}));
    }
    return worst;
}

TEST(Frame, IsOrthonormalAtEveryNormal) {
    EXPECT_LE(worst_deviation(make_frame<float>), 3e-7);
    EXPECT_GT(worst_deviation(frisvad), 1e-2) << "the mutant passed";
}

TEST(Frame, BatchesAndDoubleAgree) {
    for (const Vec3<double>& n : normals()) {
        const Frame<FloatV> f = make_frame(vector<FloatV>(n));
        const Vec3<double> rounded = lane(f.n, kLanes - 1);
        const Frame<double> exact = make_frame(rounded);
        EXPECT_LE(length(lane(f.t, kLanes - 1) - exact.t), 3e-7);
        EXPECT_LE(length(lane(f.b, 0) - exact.b), 3e-7);
    }
}

TEST(Frame, ThereAndBackIsTheIdentity) {
    const Vec3<float> v = vector<float>(normalize(Vec3<double>{0.3, -0.5, 0.7}));
    for (const Vec3<double>& n : normals()) {
        const Frame<float> frame = make_frame(vector<float>(n));
        const Vec3<float> back = to_world(frame, to_local(frame, v));
        EXPECT_LE(length(lane(back - v, 0)), 6e-7);
        EXPECT_NEAR(to_local(frame, v).z, dot(v, frame.n), 1e-7);
    }
}

}  // namespace
}  // namespace footlight::testing
