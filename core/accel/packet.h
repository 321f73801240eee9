// Embree's ray packets of the batch's width: one name for rtcIntersect4, 8 and 16.
#pragma once

#include <embree3/rtcore.h>

#include "math/simd.h"

namespace footlight {

template <int Lanes>
struct Packet;

template <>
struct Packet<4> {
    using RayHit = RTCRayHit4;
    using Ray = RTCRay4;
    static void intersect(const int* valid, RTCScene scene, RTCIntersectContext* context, RayHit* rays) {
        rtcIntersect4(valid, scene, context, rays);
    }
    static void occluded(const int* valid, RTCScene scene, RTCIntersectContext* context, Ray* rays) {
        rtcOccluded4(valid, scene, context, rays);
    }
};

template <>
struct Packet<8> {
    using RayHit = RTCRayHit8;
    using Ray = RTCRay8;
    static void intersect(const int* valid, RTCScene scene, RTCIntersectContext* context, RayHit* rays) {
        rtcIntersect8(valid, scene, context, rays);
    }
    static void occluded(const int* valid, RTCScene scene, RTCIntersectContext* context, Ray* rays) {
        rtcOccluded8(valid, scene, context, rays);
    }
};

template <>
struct Packet<16> {
    using RayHit = RTCRayHit16;
    using Ray = RTCRay16;
    static void intersect(const int* valid, RTCScene scene, RTCIntersectContext* context, RayHit* rays) {
        rtcIntersect16(valid, scene, context, rays);
    }
    static void occluded(const int* valid, RTCScene scene, RTCIntersectContext* context, Ray* rays) {
        rtcOccluded16(valid, scene, context, rays);
    }
};

}  // namespace footlight
