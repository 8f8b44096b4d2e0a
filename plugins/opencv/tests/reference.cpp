// The work of `register_opencv` and `composite_opencv` as a plain program, in the order of OpenCV's own stitcher. The test beside it
// holds the nodes against what this writes; by hand it shows what the library alone takes:
//
//   c++ -O2 reference.cpp -o reference $(pkg-config --cflags --libs opencv4)
//   ./reference LEFT RIGHT OUT.ppm SEAM_MEGAPIXELS graph_cut|dynamic_programming color|color_grad THREADS ROUNDS
//
// Prints the homography, the canvas (left, top, width, height) and the median time of each stage, ms of the clock and of the processor.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <map>
#include <string>
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/stitching/detail/blenders.hpp>
#include <opencv2/stitching/detail/exposure_compensate.hpp>
#include <opencv2/stitching/detail/seam_finders.hpp>

using namespace cv;

static double now_ms(clockid_t clock) {
    timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * 1e3 + t.tv_nsec / 1e6;
}

static std::map<std::string, std::vector<std::pair<double, double>>> stages;

struct Stage {
    std::string name;
    double wall = now_ms(CLOCK_MONOTONIC), processor = now_ms(CLOCK_PROCESS_CPUTIME_ID);
    explicit Stage(const char* name) : name(name) {}
    ~Stage() {
        stages[name].push_back({now_ms(CLOCK_MONOTONIC) - wall, now_ms(CLOCK_PROCESS_CPUTIME_ID) - processor});
    }
};

static Mat registration(const Mat& left, const Mat& right) {
    std::vector<KeyPoint> points_left, points_right;
    Mat rows_left, rows_right;
    {
        Stage stage("features");
        Ptr<SIFT> sift = SIFT::create();
        sift->detectAndCompute(left, noArray(), points_left, rows_left);
        sift->detectAndCompute(right, noArray(), points_right, rows_right);
    }
    std::vector<Point2d> from, to;
    {
        Stage stage("match");
        std::vector<std::vector<DMatch>> found;
        BFMatcher(NORM_L2).knnMatch(rows_left, rows_right, found, 2);
        for (const auto& pair : found) {
            if (pair.size() == 2 && pair[0].distance < 0.75 * pair[1].distance) {
                from.push_back(points_right[pair[0].trainIdx].pt);
                to.push_back(points_left[pair[0].queryIdx].pt);
            }
        }
    }
    Stage stage("ransac");
    return findHomography(from, to, RANSAC, 3.0, noArray(), 2000, 0.995);
}

int main(int count, char** words) {
    if (count != 9) return 2;
    const Mat left = imread(words[1]), right = imread(words[2]);
    const double megapixels = atof(words[4]);
    const bool cut = std::string(words[5]) == "graph_cut", color = std::string(words[6]) == "color";
    setNumThreads(atoi(words[7]));
    Mat gray_left, gray_right, picture, map;
    cvtColor(left, gray_left, COLOR_BGR2GRAY);
    cvtColor(right, gray_right, COLOR_BGR2GRAY);
    Rect canvas;
    for (int round = 0; round < atoi(words[8]); round++) {
        Stage whole("whole");
        map = registration(gray_left, gray_right);
        if (map.empty()) return 3;
        Mat images[2], masks[2];
        std::vector<Point> corners(2);
        {
            Stage stage("warp");
            std::vector<Point2f> box = {{0, 0}, {float(right.cols), 0}, {float(right.cols), float(right.rows)}, {0, float(right.rows)}}, at;
            perspectiveTransform(box, at, map);
            const Rect place = boundingRect(at);
            const Mat local = (Mat_<double>(3, 3) << 1, 0, -place.x, 0, 1, -place.y, 0, 0, 1) * map;
            images[0] = left.clone();
            masks[0] = Mat(left.size(), CV_8U, Scalar(255));
            warpPerspective(right, images[1], local, place.size(), INTER_LINEAR, BORDER_REFLECT);
            warpPerspective(Mat(right.size(), CV_8U, Scalar(255)), masks[1], local, place.size(), INTER_NEAREST);
            corners[1] = place.tl();
            canvas = place | Rect(Point(), left.size());
        }
        const double scale = megapixels > 0 ? std::min(1.0, std::sqrt(megapixels * 1e6 / left.total())) : 1.0;
        Mat small[2] = {images[0], images[1]}, small_masks[2] = {masks[0], masks[1]};
        std::vector<Point> small_corners = corners;
        {
            Stage stage("gain");
            std::vector<UMat> seen(2), known(2);
            for (int i = 0; i < 2; i++) {
                if (scale < 1) {
                    resize(images[i], small[i], Size(), scale, scale, INTER_LINEAR_EXACT);
                    resize(masks[i], small_masks[i], Size(), scale, scale, INTER_NEAREST);
                    small_corners[i] = Point(cvRound(corners[i].x * scale), cvRound(corners[i].y * scale));
                }
                small[i].copyTo(seen[i]);
                small_masks[i].copyTo(known[i]);
            }
            detail::GainCompensator gains;
            static_cast<detail::ExposureCompensator&>(gains).feed(small_corners, seen, known);
            for (int i = 0; i < 2; i++) {
                gains.apply(i, corners[i], images[i], masks[i]);
                if (scale < 1) gains.apply(i, small_corners[i], small[i], small_masks[i]);
            }
        }
        {
            Stage stage("seam");
            std::vector<UMat> floats(2), labels(2);
            for (int i = 0; i < 2; i++) {
                small[i].convertTo(floats[i], CV_32F);
                small_masks[i].copyTo(labels[i]);
            }
            using Cut = detail::GraphCutSeamFinder;
            using Path = detail::DpSeamFinder;
            if (cut) Cut(color ? Cut::COST_COLOR : Cut::COST_COLOR_GRAD).find(floats, small_corners, labels);
            else Path(color ? Path::COLOR : Path::COLOR_GRAD).find(floats, small_corners, labels);
            for (int i = 0; i < 2; i++) {
                Mat label;
                labels[i].copyTo(label);
                if (scale < 1) {
                    dilate(label, label, Mat());
                    resize(label, label, masks[i].size(), 0, 0, INTER_LINEAR_EXACT);
                    masks[i] &= label;
                } else {
                    masks[i] = label;
                }
            }
        }
        Stage stage("blend");
        const double width = std::sqrt(double(canvas.area())) * 0.05;
        detail::MultiBandBlender blender(false, int(std::ceil(std::log2(width))) - 1);
        blender.prepare(canvas);
        for (int i = 0; i < 2; i++) {
            Mat wide;
            images[i].convertTo(wide, CV_16S);
            blender.feed(wide, masks[i], corners[i]);
        }
        Mat blended, covered;
        blender.blend(blended, covered);
        blended.convertTo(picture, CV_8U);
    }
    printf("homography");
    for (int i = 0; i < 9; i++) printf(" %.12g", map.at<double>(i / 3, i % 3));
    printf("\ncanvas %d %d %d %d\n", -canvas.x, -canvas.y, canvas.width, canvas.height);
    for (auto& [name, times] : stages) {
        std::sort(times.begin(), times.end());
        const double wall = times[times.size() / 2].first;
        for (auto& time : times) std::swap(time.first, time.second);
        std::sort(times.begin(), times.end());
        printf("%s %.2f %.2f\n", name.c_str(), wall, times[times.size() / 2].first);
    }
    return imwrite(words[3], picture) ? 0 : 4;
}
