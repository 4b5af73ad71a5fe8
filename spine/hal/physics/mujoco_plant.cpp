// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/mujoco_plant.hpp"

#ifdef LITHE_MUJOCO

#include <dlfcn.h>
#include <fmt/format.h>
#include <mujoco/mujoco.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <string_view>
#include <utility>

#include "spine/core/host/files.hpp"
#include "spine/core/text.hpp"

namespace lithe::hal::sim {
namespace {

constexpr std::size_t kMaxModelBytes = std::size_t{64} << 20;
constexpr double kRoundingRad = 1e-4;  // what is advised has so many digits

// The functions used of the library, which stays loaded.
struct Library {
  decltype(&mj_version) version;
  decltype(&mj_loadXML) load;
  decltype(&mj_deleteModel) delete_model;
  decltype(&mj_makeData) make_data;
  decltype(&mj_deleteData) delete_data;
  decltype(&mj_name2id) find;
  decltype(&mj_id2name) name;
  // Bounded by the model; allocates only for meshes in contact (its documentation, and a test).
  void (*forward)(const mjModel*, mjData*) LITHE_RT;
  void (*reset)(const mjModel*, mjData*) LITHE_RT;
  void (*step)(const mjModel*, mjData*) LITHE_RT;
};

// MuJoCo cannot continue after an error, for example when a model needs more memory than its file allows.
void end_with(const char* what) {
  std::fprintf(stderr, "lithe: MuJoCo gives up: %s\n", what);
  std::abort();
}
void be_silent(const char* /*what*/) {}  // it would write a file; warnings are counted in its data

template <class T>
bool fill(void* handle, const char* symbol, T& out) {
  out = reinterpret_cast<T>(::dlsym(handle, symbol));
  return out != nullptr;
}

Result<Library> open_library() {
  const std::string how = "; apt-get install libmujoco-dev, and build LITHE again";
  void* handle = ::dlopen(LITHE_MUJOCO, RTLD_NOW | RTLD_LOCAL);
  if (handle == nullptr) return Error{std::string("MuJoCo cannot be loaded: ") + ::dlerror() + how};
  Library all{};
  void (**on_error)(const char*) = nullptr;
  void (**on_warning)(const char*) = nullptr;
  const bool whole = fill(handle, "mj_version", all.version) && fill(handle, "mj_loadXML", all.load) &&
                     fill(handle, "mj_deleteModel", all.delete_model) && fill(handle, "mj_makeData", all.make_data) &&
                     fill(handle, "mj_deleteData", all.delete_data) && fill(handle, "mj_name2id", all.find) &&
                     fill(handle, "mj_id2name", all.name) && fill(handle, "mj_forward", all.forward) &&
                     fill(handle, "mj_resetData", all.reset) && fill(handle, "mj_step", all.step) &&
                     fill(handle, "mju_user_error", on_error) && fill(handle, "mju_user_warning", on_warning);
  if (!whole) return Error{std::string(LITHE_MUJOCO) + " is no MuJoCo" + how};
  if (all.version() != mjVERSION_HEADER) {
    return Error{std::string(LITHE_MUJOCO) + " is version " + std::to_string(all.version()) + ", LITHE was built for " +
                 std::to_string(mjVERSION_HEADER) + how};
  }
  *on_error = end_with;
  *on_warning = be_silent;
  return all;
}

// What MuJoCo does not say: that the model may be fine, and the library old.
std::string older_than_the_model(std::string_view why) {
  if (why.find("Schema violation") == std::string_view::npos && why.find("nvalid keyword") == std::string_view::npos)
    return {};
  constexpr int kVersion = mjVERSION_HEADER;  // 222: 2.2.2
  return fmt::format(
      "; this is MuJoCo {}.{}.{}, and a model for a newer one (the wheel of `pip install mujoco`) may have words that "
      "it "
      "does not know: leave them out, or build LITHE where that version is installed",
      kVersion / 100, kVersion / 10 % 10, kVersion % 10);
}

class MujocoPlant final : public Mechanism {
 public:
  explicit MujocoPlant(const Library& library)
      : library_(library), model_(nullptr, library.delete_model), data_(nullptr, library.delete_data) {}

  Result<> open(const MujocoParams& params, Clock clock) {
    if (const auto text = read_regular_file(params.model, kMaxModelBytes); !text) return text.error();
    std::array<char, 1000> why{};
    std::error_code unknown;
    // Behind a symbolic link the files that it includes are beside the real one.
    const std::string real = std::filesystem::canonical(params.model, unknown).string();
    model_.reset(library_.load(real.c_str(), nullptr, why.data(), static_cast<int>(why.size())));
    if (!model_) return Error{params.model + ": " + printable(why.data(), true) + older_than_the_model(why.data())};
    model_->opt.timestep = 1e-9 * static_cast<double>(params.step_ns);
    model_->opt.disableflags |= mjDSBL_ACTUATION;
    parts_ = std::max<std::int64_t>(params.step_ns / Plant::kStepNs, 1);
    data_.reset(library_.make_data(model_.get()));
    if (!data_) return Error{params.model + ": no memory for its simulation"};
    for (const MujocoJoint& joint : params.joints)
      if (Result<> added = add(joint); !added) return Error{params.model + ": " + added.message()};
    if (Result<> found = find_imu(params.imu); !found) return Error{params.model + ": " + found.message()};
    place();
    if (const std::int64_t takes_ns = quickest_step_ns(clock); takes_ns > params.step_ns) {
      return Error{params.model + ": a step of " + std::to_string(params.step_ns / 1000) + " us takes " +
                   std::to_string(takes_ns / 1000) + " us here, it cannot keep up; give a longer step_s"};
    }
    place();
    return done();
  }

  void step(std::span<const double> wanted_nm) LITHE_RT override {
    for (std::size_t i = 0; i < joints_.size(); ++i) {
      Joint& joint = joints_[i];
      const double wanted = i < wanted_nm.size() ? wanted_nm[i] : 0;
      joint.torque_nm = Plant::lagged_nm(joint.torque_nm, wanted, joint.most_nm, joint.lag_gain);
    }
    if (part_ == 0) move();
    part_ = (part_ + 1) % parts_;
    const double share = part_ == 0 ? 1 : static_cast<double>(part_) / static_cast<double>(parts_);
    for (Joint& joint : joints_) {
      const double to_rad = data_->qpos[joint.position];
      joint.position_rad = share == 1 ? to_rad : joint.from_rad + share * (to_rad - joint.from_rad);
    }
  }

  void to_start() LITHE_RT override {
    for (Joint& joint : joints_) {
      joint.torque_nm = 0;
      joint.position_rad = joint.from_rad = joint.start_rad;
    }
    part_ = 0;
    place();
  }

  std::size_t joints() const LITHE_RT override { return joints_.size(); }
  double position_rad(std::size_t joint) const LITHE_RT override { return joints_[joint].position_rad; }
  double velocity_rad_s(std::size_t joint) const LITHE_RT override { return data_->qvel[joints_[joint].freedom]; }
  double torque_nm(std::size_t joint) const LITHE_RT override { return joints_[joint].torque_nm; }
  void read_imu(std::array<double, kImuChannels>& out) const LITHE_RT override {
    for (std::size_t i = 0; i < imu_.size(); ++i) out[i] = imu_[i] != nullptr ? *imu_[i] : kLevelImu[i];
  }
  double inertia_kg_m2(std::size_t joint) const override { return model_->dof_M0[joints_[joint].freedom]; }

 private:
  struct Joint {
    int position, freedom;  // indices into qpos and qvel
    double lag_gain, most_nm;
    double torque_nm = 0, from_rad = 0, position_rad = 0, start_rad = 0;
  };

  Result<> add(const MujocoJoint& joint) {
    const int id = library_.find(model_.get(), mjOBJ_JOINT, joint.name.c_str());
    if (id < 0) return Error{"there is no joint '" + joint.name + "'; its hinges: " + hinges()};
    if (model_->jnt_type[id] != mjJNT_HINGE) {
      return Error{"joint '" + joint.name +
                   "' is no hinge; drives turn hinges only: make it one, or leave the joint out of the robot file"};
    }
    if (Result<> checked = check_range(joint, id); !checked) return checked;
    Joint own{model_->jnt_qposadr[id], model_->jnt_dofadr[id], Plant::lag_gain(joint.torque_lag_s),
              joint.torque_max_nm};
    own.position_rad = own.from_rad = own.start_rad = joint.initial_position_rad;
    joints_.push_back(own);
    return done();
  }

  // Against its stop in the model a joint would never arrive, and from beyond it it would leap.
  Result<> check_range(const MujocoJoint& joint, int id) const {
    if (model_->jnt_limited[id] == 0) return done();
    const double least_rad = model_->jnt_range[2 * id], most_rad = model_->jnt_range[2 * id + 1];
    const auto inside = [&](double rad) { return rad >= least_rad - kRoundingRad && rad <= most_rad + kRoundingRad; };
    const std::string range =
        fmt::format("joint '{}' turns from {:.4g} to {:.4g} rad in the model", joint.name, least_rad, most_rad);
    if (!inside(joint.position_min_rad) || !inside(joint.position_max_rad))
      return Error{
          fmt::format("{}, and from {:g} to {:g} by the robot file: write position_min_rad = {:.4f} and "
                      "position_max_rad = {:.4f}, or give it a wider range in the model",
                      range, joint.position_min_rad, joint.position_max_rad,
                      std::max(joint.position_min_rad, least_rad), std::min(joint.position_max_rad, most_rad))};
    if (!inside(joint.initial_position_rad))
      return Error{
          fmt::format("{}, and starts at {:g}: write an initial_position_rad inside that range in its "
                      "[joint.sim]",
                      range, joint.initial_position_rad)};
    return done();
  }

  // The first sensor of each kind, by which IMUs are described in MJCF.
  Result<> find_imu(bool wanted) {
    struct Part {
      mjtSensor type;
      std::size_t channel;
    };
    std::size_t found = 0;
    for (const Part& part : {Part{mjSENS_FRAMEQUAT, 0}, Part{mjSENS_GYRO, 4}, Part{mjSENS_ACCELEROMETER, 7}}) {
      const std::span<const int> types(model_->sensor_type, static_cast<std::size_t>(model_->nsensor));
      const auto id = static_cast<int>(std::ranges::find(types, static_cast<int>(part.type)) - types.begin());
      if (id == model_->nsensor) continue;
      ++found;
      for (int i = 0; i < model_->sensor_dim[id]; ++i)
        imu_[part.channel + static_cast<std::size_t>(i)] = &data_->sensordata[model_->sensor_adr[id] + i];
    }
    if (!wanted || found == 3) return done();
    return Error{
        "the robot file has a device of kind \"imu\", and the model lacks its sensors: write <site name=\"imu\"/> in "
        "the "
        "body that carries it, and <sensor><framequat objtype=\"site\" objname=\"imu\"/><gyro site=\"imu\"/>"
        "<accelerometer site=\"imu\"/></sensor>"};
  }

  // Resets everything to the start.
  void place() LITHE_RT {
    library_.reset(model_.get(), data_.get());
    for (const Joint& joint : joints_) data_->qpos[joint.position] = joint.position_rad;
    library_.forward(model_.get(), data_.get());
  }

  // Time of the fastest few consecutive steps at the start, to exclude disturbances by other programs.
  std::int64_t quickest_step_ns(Clock clock) {
    constexpr int kBatches = 10, kSteps = 10;
    std::int64_t best_ns = std::numeric_limits<std::int64_t>::max();
    for (int batch = 0; batch < kBatches; ++batch) {
      const std::int64_t began_ns = clock();
      for (int i = 0; i < kSteps; ++i) library_.step(model_.get(), data_.get());
      best_ns = std::min(best_ns, (clock() - began_ns) / kSteps);
    }
    return best_ns;
  }

  std::string hinges() const {
    std::string names;
    for (int id = 0; id < model_->njnt; ++id) {
      const char* name = library_.name(model_.get(), mjOBJ_JOINT, id);
      if (model_->jnt_type[id] == mjJNT_HINGE && name != nullptr)
        names += (names.empty() ? "" : ", ") + std::string(name);
    }
    return names.empty() ? "none that has a name" : names;
  }

  void move() LITHE_RT {
    for (Joint& joint : joints_) {
      joint.from_rad = data_->qpos[joint.position];
      data_->qfrc_applied[joint.freedom] = joint.torque_nm;
    }
    library_.step(model_.get(), data_.get());
  }

  Library library_;
  std::unique_ptr<mjModel, decltype(&mj_deleteModel)> model_;
  std::unique_ptr<mjData, decltype(&mj_deleteData)> data_;
  std::vector<Joint> joints_;
  std::array<const mjtNum*, kImuChannels> imu_{};
  std::int64_t parts_ = 1;  // drive steps per physics step
  std::int64_t part_ = 0;
};

}  // namespace

Result<std::unique_ptr<Mechanism>> open_mujoco(const MujocoParams& params, Clock clock) {
  const Result<Library> library = open_library();
  if (!library) return library.error();
  auto plant = std::make_unique<MujocoPlant>(*library);
  if (Result<> opened = plant->open(params, clock); !opened) return opened.error();
  return std::unique_ptr<Mechanism>(std::move(plant));
}

}  // namespace lithe::hal::sim

#else

namespace lithe::hal::sim {

Result<std::unique_ptr<Mechanism>> open_mujoco(const MujocoParams& params, Clock /*clock*/) {
  return Error{params.model +
               ": this LITHE was built without MuJoCo; apt-get install libmujoco-dev, and build it again"};
}

}  // namespace lithe::hal::sim

#endif
