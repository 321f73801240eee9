// Camera rays: a perspective camera, with a thin lens when the scene asks for depth of field.
#pragma once

#include "math/warp.h"
#include "scene/scene.h"

namespace footlight {

// The camera in the render's own space: its position is the origin.
struct CameraRays {
    Vec3<float> right, up, back;        // unit axes
    float scale_x, offset_x;            // raster x -> slope along `right`
    float scale_y, offset_y;            // raster y (down) -> slope along `up`
    float near_distance, far_distance;  // along the view axis [stage units]
    float lens_radius;                  // [stage units]
    float inverse_focus;                // 1 / focus distance [1 / stage unit]
};

inline CameraRays make_camera_rays(const Camera& camera, int width, int height) {
    const auto axis = [&](int i) {
        const Vec3<double> v = normalize(row(camera.camera_to_world, i));
        return Vec3<float>{static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
    };
    // Distances along the view are in camera space: the transform's scale applies to them.
    const double depth_scale = length(row(camera.camera_to_world, 2));
    const double lens_scale = length(row(camera.camera_to_world, 0));
    const double slope_x = camera.horizontal_aperture / camera.focal_length;
    const double slope_y = camera.vertical_aperture / camera.focal_length;
    CameraRays rays{};
    rays.right = axis(0);
    rays.up = axis(1);
    rays.back = axis(2);
    rays.scale_x = static_cast<float>(slope_x / width);
    rays.offset_x = static_cast<float>(camera.horizontal_aperture_offset / camera.focal_length - slope_x / 2);
    rays.scale_y = static_cast<float>(-slope_y / height);
    rays.offset_y = static_cast<float>(camera.vertical_aperture_offset / camera.focal_length + slope_y / 2);
    rays.near_distance = static_cast<float>(camera.clipping_range[0] * depth_scale);
    rays.far_distance = static_cast<float>(camera.clipping_range[1] * depth_scale);
    // UsdGeomCamera: focal length in tenths of a stage unit; radius = focal length / (2 f-stop).
    if (camera.f_stop > 0 && camera.focus_distance > 0) {
        rays.lens_radius = static_cast<float>(0.1 * camera.focal_length / (2 * camera.f_stop) * lens_scale);
        rays.inverse_focus = static_cast<float>(1.0 / (camera.focus_distance * depth_scale));
    }
    return rays;
}

template <class F>
struct CameraRay {
    Vec3<F> origin, direction;  // direction unit
    F tnear, tfar;
};

// x, y: raster position [pixels]. Without a lens the origin is the render origin.
template <class F>
inline CameraRay<F> pinhole_ray(const CameraRays& c, F x, F y, Vec3<F> lens_point, Vec3<F> lens_slope) {
    const F sx = fma(x, F(c.scale_x), F(c.offset_x)) - lens_slope.x;
    const F sy = fma(y, F(c.scale_y), F(c.offset_y)) - lens_slope.y;
    const Vec3<F> d = broadcast<F>(c.right) * sx + broadcast<F>(c.up) * sy - broadcast<F>(c.back);
    const F l = length(d);
    return {lens_point, d * (F(1) / l), F(c.near_distance) * l, F(c.far_distance) * l};
}

template <class F>
inline CameraRay<F> pinhole_ray(const CameraRays& c, F x, F y) {
    const Vec3<F> none{F(0), F(0), F(0)};
    return pinhole_ray<F>(c, x, y, none, none);
}

// The same ray from a point of the lens through the same point of the focus plane. With radius 0 it is pinhole_ray to
// the bit: the slope of the pinhole ray changes by lens position / focus distance.
template <class F>
inline CameraRay<F> lens_ray(const CameraRays& c, F x, F y, F u, F v) {
    const Disk<F> disk = uniform_disk(u, v);
    const F lx = disk.x * F(c.lens_radius), ly = disk.y * F(c.lens_radius);
    const Vec3<F> point = broadcast<F>(c.right) * lx + broadcast<F>(c.up) * ly;
    return pinhole_ray<F>(c, x, y, point, {lx * F(c.inverse_focus), ly * F(c.inverse_focus), F(0)});
}

}  // namespace footlight
