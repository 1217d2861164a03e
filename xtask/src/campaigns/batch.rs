//! Files that let an engine run the parts of a campaign: with index, retry and collection.

use super::Error;
use crate::cli::{Batch, Engine};

/// How often a part is tried. A journal lets each try go on where the last one ended.
const TRIES: u32 = 3;

/// The file for the engine.
///
/// # Errors
/// The options do not fit.
pub(super) fn text(options: &Batch) -> Result<String, Error> {
    if options.shards > options.faults {
        return Err(Error::TooMany {
            shards: options.shards,
            sequences: options.faults,
        });
    }
    checked(options)?;
    let on_kubernetes = options.engine == Engine::Kubernetes;
    if on_kubernetes && (!options.dir.starts_with('/') || options.dir.contains(':')) {
        return Err(Error::Relative {
            dir: options.dir.clone(),
        });
    }
    let job = Job::new(options);
    Ok(match options.engine {
        Engine::Parallel => job.parallel(),
        Engine::Slurm => job.slurm(),
        Engine::Kubernetes => match (&options.image, &options.claim) {
            (Some(image), Some(claim)) => job.kubernetes(image, claim),
            _ => return Err(Error::NoImage),
        },
    })
}

/// Refuses texts that a shell or YAML would not take as one word.
fn checked(options: &Batch) -> Result<(), Error> {
    // A value with its unit has a blank; it is quoted.
    let sets = options.changes.set.iter();
    let sets = sets.map(|set| ("--set", set.to_string().replace(' ', "")));
    let mut texts: Vec<(&'static str, String)> = sets.collect();
    texts.push(("--dir", options.dir.clone()));
    texts.extend(options.image.iter().map(|text| ("--image", text.clone())));
    texts.extend(options.claim.iter().map(|text| ("--claim", text.clone())));
    let plain = |one: char| one.is_ascii_alphanumeric() || "-_./:=@+".contains(one);
    let mut odd = texts
        .into_iter()
        .filter(|(_, text)| text.is_empty() || text.starts_with('-') || !text.chars().all(plain));
    match odd.next() {
        None => Ok(()),
        Some((option, text)) => Err(Error::Odd { option, text }),
    }
}

struct Job {
    /// Options of `sim` and `build` that say which images run.
    images: String,
    /// Options of `sim` that say which sequences run.
    sequences: String,
    shards: u64,
    dir: String,
    about: String,
}

impl Job {
    fn new(options: &Batch) -> Self {
        let mut images = format!(" --vehicle {}", options.vehicle);
        for set in &options.changes.set {
            images += &format!(" --set \"{set}\"");
        }
        if let Some(bus) = options.changes.bus {
            images += &format!(" --bus {}", bus.name());
        }
        let attacker = if options.attacker { " --attacker" } else { "" };
        let kind = if options.attacker { "attack" } else { "fault" };
        Self {
            sequences: format!(
                " --faults {}{attacker} --seed {}",
                options.faults, options.seed
            ),
            about: format!(
                "{} {kind} sequences of {} in {} parts",
                options.faults, options.vehicle, options.shards
            ),
            images,
            shards: options.shards,
            dir: options.dir.clone(),
        }
    }

    /// The part whose number a shell has in a variable, or in the braces of GNU parallel. It fails only
    /// if it could not be run: the whole judges what it has found.
    fn part(&self, index: &str) -> String {
        let Self {
            images,
            sequences,
            shards,
            dir,
            ..
        } = self;
        format!(
            "cargo xtask sim{sequences}{images} --shard {index}/{shards} --out {dir} --resume --collect > \
             {dir}/part-{index}.txt 2>&1"
        )
    }

    fn collect(&self) -> String {
        let Self { shards, dir, .. } = self;
        format!(
            "cargo xtask campaign merge {dir}/faults-*-of-{shards}.json --out {dir}/faults.json"
        )
    }

    /// A script around GNU parallel.
    fn parallel(&self) -> String {
        let Self {
            about,
            images,
            shards,
            dir,
            ..
        } = self;
        let (part, collect) = (self.part("{}"), self.collect());
        format!(
            "#!/bin/sh\n\
             # {about}: sh FILE [JOBS AT ONCE], from the folder of the workspace. Each job uses all cores.\n\
             set -eu\n\
             mkdir -p {dir}\n\
             # Once, so that the parts find their images built.\n\
             cargo xtask build{images} > /dev/null\n\
             seq 1 {shards} | parallel --jobs \"${{1:-1}}\" --retries {TRIES} --joblog {dir}/jobs.log '{part}'\n\
             {collect}\n"
        )
    }

    /// A job array for Slurm.
    fn slurm(&self) -> String {
        let Self {
            about, shards, dir, ..
        } = self;
        let part = self.part("$SLURM_ARRAY_TASK_ID");
        let collect = self.collect();
        format!(
            "#!/bin/bash\n\
             # {about}. From the folder of the workspace, which all machines share:\n\
             #   mkdir -p {dir}\n\
             #   job=$(sbatch --parsable FILE)\n\
             #   sbatch --dependency=afterok:$job --wrap '{collect}'\n\
             # The cluster's MaxArraySize (1001 if nobody has set it) must be above {shards}.\n\
             #SBATCH --job-name=furrow\n\
             #SBATCH --array=1-{shards}\n\
             #SBATCH --cpus-per-task=2\n\
             #SBATCH --mem-per-cpu=2G\n\
             #SBATCH --requeue\n\
             #SBATCH --output={dir}/slurm-%a.txt\n\
             for try in $(seq {TRIES}); do\n    \
                 {part} && exit 0\n\
             done\n\
             exit 1\n"
        )
    }

    /// An indexed job for Kubernetes.
    fn kubernetes(&self, image: &str, claim: &str) -> String {
        let Self {
            about, shards, dir, ..
        } = self;
        let part = self.part("$i");
        let collect = self.collect();
        let job = |name: &str, index: &str, command: &str| {
            let indent = "                ";
            format!(
                "apiVersion: batch/v1\n\
                 kind: Job\n\
                 metadata:\n  \
                   name: {name}\n\
                 spec:\n\
                 {index}  \
                   template:\n    \
                     spec:\n      \
                       restartPolicy: Never\n      \
                       containers:\n        \
                         - name: furrow\n          \
                           image: {image}\n          \
                           command:\n            \
                             - sh\n            \
                             - -c\n            \
                             - |\n\
                 {indent}{command}\n          \
                           volumeMounts:\n            \
                             - name: results\n              \
                               mountPath: {dir}\n      \
                       volumes:\n        \
                         - name: results\n          \
                           persistentVolumeClaim:\n            \
                             claimName: {claim}\n"
            )
        };
        let tries = TRIES - 1;
        let index = format!(
            "  completionMode: Indexed\n  completions: {shards}\n  parallelism: {shards}\n  \
             backoffLimitPerIndex: {tries}\n"
        );
        let parts = format!("i=$((JOB_COMPLETION_INDEX + 1)); {part}");
        format!(
            "# {about}. The image has this workspace as its working directory, and Rust.\n\
             #   kubectl apply -f FILE -l step=parts; kubectl get job furrow-parts -w   until Complete or Failed\n\
             #   kubectl apply -f FILE -l step=merge; kubectl logs -f job/furrow-merge   fails if a rule was broken\n\
             {}---\n{}",
            job("furrow-parts\n  labels:\n    step: parts", &index, &parts),
            job(
                "furrow-merge\n  labels:\n    step: merge",
                "  backoffLimit: 0\n",
                &collect
            ),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Changes;

    fn options(engine: Engine) -> Batch {
        Batch {
            engine,
            faults: 100,
            shards: 8,
            attacker: true,
            seed: 5,
            vehicle: "uagv".into(),
            changes: Changes::default(),
            dir: "/results".into(),
            image: None,
            claim: None,
            out: None,
        }
    }

    #[test]
    fn each_engine_counts_the_parts_from_one() {
        let run = "cargo xtask sim --faults 100 --attacker --seed 5 --vehicle uagv --shard";
        let script = text(&options(Engine::Parallel)).unwrap();
        assert!(
            script.contains(&format!("{run} {{}}/8 --out /results --resume")),
            "{script}"
        );
        let script = text(&options(Engine::Slurm)).unwrap();
        assert!(script.contains("#SBATCH --array=1-8\n"), "{script}");
        assert!(
            script.contains(&format!("{run} $SLURM_ARRAY_TASK_ID/8")),
            "{script}"
        );
        let mut kubernetes = options(Engine::Kubernetes);
        assert!(matches!(text(&kubernetes), Err(Error::NoImage)));
        kubernetes.image = Some("lab/furrow:1".into());
        kubernetes.claim = Some("results".into());
        kubernetes.dir = "results".into();
        assert!(matches!(text(&kubernetes), Err(Error::Relative { .. })));
        kubernetes.dir = "/results".into();
        let jobs = text(&kubernetes).unwrap();
        assert!(jobs.contains("completions: 8\n"), "{jobs}");
        assert!(jobs.contains("i=$((JOB_COMPLETION_INDEX + 1)); "), "{jobs}");
        assert!(jobs.contains(&format!("{run} $i/8")), "{jobs}");
    }

    #[test]
    fn what_would_end_its_place_in_the_file_is_refused() {
        for dir in ["", "a b", "run'; rm -rf x", "-x", "a\nb", "$HOME"] {
            let mut odd = options(Engine::Parallel);
            odd.dir = dir.into();
            let error = text(&odd).unwrap_err();
            assert!(
                matches!(
                    error,
                    Error::Odd {
                        option: "--dir",
                        ..
                    }
                ),
                "{error}"
            );
        }
        let mut many = options(Engine::Slurm);
        many.shards = 101;
        assert!(matches!(text(&many), Err(Error::TooMany { .. })));
    }
}
